//! Evaluation of Python callables and of drivers without training, as `iwol evaluate` does it.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use iwol_sumo::driving::{self, POLICIES, Policy};
use iwol_sumo::env::{EnvSpec, Error, Frame, Worlds};
use iwol_sumo::evaluate::{Actor, Controller, EvaluationObserver};
use iwol_sumo::metrics::{EvaluationResult, Knowledge};
use iwol_sumo::provenance::Program;
use iwol_sumo::replay::RecordedDiagnostics;
use iwol_sumo::rng::Seed;
use iwol_sumo::sumo::Hosting;
use numpy::{
    AllowTypeChange, PyArray, PyArrayLikeDyn, PyArrayMethods as _, PyUntypedArrayMethods as _,
};
use pyo3::prelude::*;
use pyo3::types::PyString;

use crate::env::refuse_after_fork;
use crate::error::{detached, exception, of_env};
use crate::task::NativeTask;

/// Plays `episodes` episodes of the stream `seed` and returns the result as the JSON that
/// `iwol evaluate --json` prints, and the records of the episodes as a JSON list. `policy` is the
/// name of a driver without training, or a callable that gets `observation [E, N, O]`,
/// `comm [E, N, N]`, `active [E, N]` and `start [E, N]`, and returns actions `[E, N, A]`, as an
/// array of any type of numbers or as lists.
#[pyfunction]
pub(crate) fn evaluate(
    py: Python<'_>,
    task: &NativeTask,
    policy: &Bound<'_, PyAny>,
    name: String,
    episodes: u64,
    seed: u64,
) -> PyResult<(String, String)> {
    refuse_after_fork(py)?;
    let stop = AtomicBool::new(false);
    let raised = Mutex::new(None);
    let callable = Callable { function: policy.clone().unbind(), stop: &stop, raised: &raised };
    let rule = policy.cast::<PyString>().ok().map(|name| name.to_string());
    if let Some(name) = rule.as_ref().filter(|name| Policy::by_name(name).is_none()) {
        let text = format!(
            "there is no policy `{name}`; choose one of {} with a in -1..1 and speed in m/s, above 0",
            POLICIES.join(", ")
        );
        return Err(exception(py, "Error", text));
    }
    let hosting = Hosting::default();
    let seeds = Seed::new(seed).child("evaluation");
    let evaluation = detached(py, || {
        let rule = rule.as_deref().and_then(Policy::by_name);
        let policy = rule.unwrap_or(Policy::Learned(&callable));
        let mut report = |_| callable.check_signals();
        let observer =
            EvaluationObserver { stop: &stop, report: &mut report, recorder: None, beside: false };
        driving::evaluate(&task.task, &policy, episodes, seeds, &hosting, observer)
    })?;
    if let Some(error) = raised.lock().ok().and_then(|mut raised| raised.take()) {
        return Err(error);
    }
    let evaluation = evaluation.map_err(|error| of_env(py, &error))?;
    let Some(metrics) = evaluation.metrics() else {
        return Err(exception(py, "Error", "no episode finished".into()));
    };
    let agents = task.task.agents;
    let result = EvaluationResult {
        scenario: task.task.scenario.name.clone(),
        agents: task.vehicles,
        learners: (agents < task.vehicles as usize).then_some(agents),
        audited: hosting.audit,
        policy: name,
        episodes,
        seed,
        program: Program::current(),
        metrics,
        failed_episodes: evaluation.failed_episodes(),
        ..EvaluationResult::default()
    };
    let failed = |error: serde_json::Error| exception(py, "Error", error.to_string());
    let records = serde_json::to_string(&evaluation.episodes).map_err(failed)?;
    Ok((serde_json::to_string(&result).map_err(failed)?, records))
}

/// A Python function that chooses actions.
struct Callable<'a> {
    function: Py<PyAny>,
    stop: &'a AtomicBool,
    /// The exception that ended the evaluation.
    raised: &'a Mutex<Option<PyErr>>,
}

impl Callable<'_> {
    /// Ends the evaluation with an exception.
    fn fail(&self, error: PyErr) {
        self.stop.store(true, Ordering::Relaxed);
        if let Ok(mut raised) = self.raised.lock() {
            raised.get_or_insert(error);
        }
    }

    /// Ends the evaluation if the user has pressed Ctrl-C.
    fn check_signals(&self) {
        Python::attach(|py| {
            if let Err(error) = py.check_signals() {
                self.fail(error);
            }
        });
    }
}

impl Controller for Callable<'_> {
    fn actor<'a>(&'a self, spec: &'a EnvSpec, _: Seed) -> Box<dyn Actor + 'a> {
        Box::new(CallableActor { callable: self, spec })
    }
}

/// The function at work in an evaluation.
struct CallableActor<'a> {
    callable: &'a Callable<'a>,
    spec: &'a EnvSpec,
}

impl Actor for CallableActor<'_> {
    fn begin(&mut self) {}

    fn act(
        &mut self,
        worlds: &dyn Worlds,
        actions: &mut [f32],
        _: Option<usize>,
    ) -> Result<RecordedDiagnostics, Error> {
        let chosen = Python::attach(|py| {
            py.check_signals()?;
            self.call(py, worlds, actions)
        });
        if let Err(error) = chosen {
            self.callable.fail(error);
        }
        Ok(RecordedDiagnostics::default())
    }

    fn knowledge(&self) -> Vec<Knowledge> {
        Vec::new()
    }
}

impl CallableActor<'_> {
    fn call(&self, py: Python<'_>, worlds: &dyn Worlds, actions: &mut [f32]) -> PyResult<()> {
        let (e, n, spec) = (worlds.count(), self.spec.agents, self.spec);
        let numbers = |of: fn(&Frame) -> &[f32]| {
            (0..e).flat_map(|e| of(worlds.view(e).frame)).copied().collect::<Vec<f32>>()
        };
        let flags = |of| numbers(of).iter().map(|flag| *flag > 0.5).collect::<Vec<bool>>();
        let observation = PyArray::from_vec(py, numbers(|frame| &frame.observation)).reshape([
            e,
            n,
            spec.observation.len(),
        ])?;
        let comm = PyArray::from_vec(py, numbers(|frame| &frame.comm)).reshape([e, n, n])?;
        let acts = flags(|frame| &frame.active);
        let active = PyArray::from_slice(py, &acts).reshape([e, n])?;
        let start = PyArray::from_vec(py, flags(|frame| &frame.start)).reshape([e, n])?;
        let chosen = self.callable.function.bind(py).call1((observation, comm, active, start))?;
        let wanted = [e, n, spec.actions.len()];
        let kind = match chosen.getattr_opt("dtype")? {
            Some(dtype) => dtype.str()?.to_string(),
            None => chosen.get_type().name()?.to_string(),
        };
        let refused = |cause: PyErr| {
            let text = format!("the policy returned {kind} instead of numbers {wanted:?}: {cause}");
            let refusal = exception(py, "Error", text);
            refusal.set_cause(py, Some(cause));
            refusal
        };
        let array = py.import("numpy")?.call_method1("asarray", (chosen, "float32"));
        let chosen: PyArrayLikeDyn<'_, f32, AllowTypeChange> =
            array.map_err(refused)?.extract().map_err(refused)?;
        if chosen.shape() != wanted {
            let found = chosen.shape();
            let text =
                format!("the policy returned {kind} of shape {found:?} instead of {wanted:?}");
            return Err(exception(py, "Error", text));
        }
        let chosen = chosen.as_array();
        for (row, (action, acts)) in chosen.rows().into_iter().zip(acts).enumerate() {
            if acts && action.iter().any(|value| value.is_nan()) {
                let (e, i) = (row / n, row % n);
                let text = format!("the policy returned NaN for vehicle_{i} in world {e}");
                return Err(exception(py, "Error", text));
            }
        }
        for (to, from) in actions.iter_mut().zip(chosen.iter()) {
            *to = *from;
        }
        Ok(())
    }
}
