//! Worlds in lock-step, whose results are written into NumPy's arrays.

use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, TryLockError};
use std::time::Duration;

use iwol_sumo::env::{Driver, EpisodeRecord, Task, VecEnv, VecOptions, World};
use iwol_sumo::replay::{RecordedDiagnostics, Recorder, Recording, Title};
use iwol_sumo::rng::Seed;
use iwol_sumo::sumo::Hosting;
use numpy::{
    Element, PyArray, PyArray3, PyArrayDyn, PyArrayMethods as _, PyReadonlyArrayDyn,
    PyUntypedArrayMethods as _,
};
use pyo3::prelude::*;

use crate::error::{detached, exception, of_env};
use crate::picture::pixels;
use crate::task::NativeTask;

/// Process that first used an environment. The threads that start SUMO and that step worlds do not
/// exist in processes forked from it.
static FIRST_USER: OnceLock<u32> = OnceLock::new();

/// Returns whether another process, of which this one is a fork, first used an environment.
fn is_forked() -> bool {
    FIRST_USER.get().is_some_and(|first| *first != std::process::id())
}

/// Refuses to work in a process that was forked after the first use of an environment.
pub(crate) fn refuse_after_fork(py: Python<'_>) -> PyResult<()> {
    FIRST_USER.get_or_init(std::process::id);
    if !is_forked() {
        return Ok(());
    }
    let text = "environments do not work in a process that was forked after one was made or used: \
                start processes with multiprocessing.get_context(\"spawn\"), or call \
                multiprocessing.set_start_method(\"spawn\") first";
    Err(exception(py, "Error", text.into()))
}

/// Returns the stream of episodes of a user's seed, that of `iwol evaluate --seed`.
fn stream(seed: u64) -> Seed {
    Seed::new(seed).child("evaluation").child("episodes")
}

/// E worlds of one task, which step together.
#[pyclass(frozen, module = "iwol_sumo._native")]
pub(crate) struct NativeEnv {
    task: Arc<Task>,
    worlds: usize,
    hosting: Hosting,
    running: Mutex<Option<Running>>,
}

/// What exists from the first reset on.
struct Running {
    env: VecEnv,
    /// Actions of the coming step, `[E, N, A]`.
    actions: Vec<f32>,
    /// Records of the episodes that the last step ended.
    finished: Vec<EpisodeRecord>,
    /// Recorder of world 0's episode, where recordings are wanted.
    recorder: Option<Recorder>,
    seed: u64,
}

/// NumPy's arrays that receive the results of a step, as attributes of a Python object.
#[derive(FromPyObject)]
pub(crate) struct Arrays<'py> {
    /// `[E, N, O]`
    #[pyo3(attribute)]
    observation: Bound<'py, PyArrayDyn<f32>>,
    /// `[E, N, S]`
    #[pyo3(attribute)]
    state: Bound<'py, PyArrayDyn<f32>>,
    /// `[E, N, N]`
    #[pyo3(attribute)]
    comm: Bound<'py, PyArrayDyn<f32>>,
    /// `[E, N]`
    #[pyo3(attribute)]
    reward: Bound<'py, PyArrayDyn<f32>>,
    /// `[E, N]`
    #[pyo3(attribute)]
    active: Bound<'py, PyArrayDyn<bool>>,
    /// `[E, N]`
    #[pyo3(attribute)]
    terminated: Bound<'py, PyArrayDyn<bool>>,
    /// `[E, N]`
    #[pyo3(attribute)]
    truncated: Bound<'py, PyArrayDyn<bool>>,
    /// `[E, N]`
    #[pyo3(attribute)]
    start: Bound<'py, PyArrayDyn<bool>>,
    /// `[E]`
    #[pyo3(attribute)]
    interrupted: Bound<'py, PyArrayDyn<bool>>,
    /// `[E, N, 3]`: arrived, crashed, off-road.
    #[pyo3(attribute)]
    outcome: Bound<'py, PyArrayDyn<bool>>,
}

#[pymethods]
impl NativeEnv {
    /// Prepares `worlds` worlds; SUMO starts with the first reset. `processes` is the number of SUMO
    /// processes, 0 for one per core; `timeout` is the longest wait for SUMO's answer in seconds.
    #[new]
    fn new(
        py: Python<'_>,
        task: &NativeTask,
        worlds: usize,
        processes: usize,
        timeout: f64,
        audit: bool,
    ) -> PyResult<Self> {
        let Some(timeout) = Duration::try_from_secs_f64(timeout).ok().filter(|t| !t.is_zero())
        else {
            let text = format!("timeout is {timeout}; allowed: seconds above 0, up to 1e19");
            return Err(exception(py, "ArgumentError", text));
        };
        let hosting = Hosting { processes, timeout, audit, ..Hosting::default() };
        Ok(Self { task: Arc::clone(&task.task), worlds, hosting, running: Mutex::new(None) })
    }

    /// Starts the episodes `episode`, `episode + 1`, … of the stream `seed` in the worlds, and
    /// writes the first frames. `record`: whether world 0's episode is recorded.
    fn start(
        &self,
        py: Python<'_>,
        seed: u64,
        episode: u64,
        record: bool,
        arrays: Arrays<'_>,
    ) -> PyResult<()> {
        refuse_after_fork(py)?;
        let mut running = self.lock(py)?;
        let (running_now, task, worlds) = (&mut *running, &self.task, self.worlds);
        let started = detached(py, || {
            if let Some(running) = running_now {
                running.env.restart(stream(seed), episode..u64::MAX);
                running.actions.fill(0.0);
                let stepped = running.env.step(&running.actions);
                // Where SUMO broke off, no episode has begun, and the old frame is still there.
                let states = running.env.states();
                if stepped.is_ok() && !states.iter().any(|state| state.interrupted) {
                    return Ok(());
                }
                *running_now = None;
            }
            let options = VecOptions {
                worlds,
                stride: worlds as u64,
                driver: Driver::Agents,
                seed: stream(seed),
                episodes: episode..u64::MAX,
                repeat_failed: 0.0,
                hosting: self.hosting,
            };
            let actions = vec![0.0; worlds * task.agents * task.spec.actions.len()];
            VecEnv::new(task, &options).map(|env| {
                let finished = Vec::new();
                *running_now = Some(Running { env, actions, finished, recorder: None, seed });
            })
        })?;
        started.map_err(|error| of_env(py, &error))?;
        let Some(running) = running_now else { return Ok(()) };
        running.env.take_finished();
        running.finished.clear();
        running.seed = seed;
        running.recorder = record.then(|| Recorder::new(&task.spec, episode));
        self.fill(py, Some(&running.env), &arrays)
    }

    /// Performs one decision of all worlds with the actions `[E, N, A]`, and writes the next frames.
    /// Returns whether episodes have ended with it. After an error of SUMO, only a reset helps.
    fn step(
        &self,
        py: Python<'_>,
        actions: &Bound<'_, PyArrayDyn<f32>>,
        arrays: Arrays<'_>,
    ) -> PyResult<bool> {
        refuse_after_fork(py)?;
        let mut running_now = self.lock(py)?;
        let Some(running) = running_now.as_mut() else {
            let text = "step() before reset(), or after close() or a SumoError: call reset() first";
            return Err(exception(py, "Error", text.into()));
        };
        self.fill(py, None, &arrays)?;
        self.take_actions(py, actions, running)?;
        let Running { env, actions, finished, recorder, .. } = running;
        if let Some(recorder) = &mut *recorder
            && let Some(e) = recorder.watches(env)
        {
            let width = self.task.agents * self.task.spec.actions.len();
            let actions = &actions[e * width..][..width];
            recorder.decide(env, e, actions, &RecordedDiagnostics::default());
        }
        let taken = detached(py, || env.step(actions))?;
        if let Err(error) = taken {
            *running_now = None;
            return Err(of_env(py, &error));
        }
        if let Some(recorder) = &mut *recorder {
            recorder.reward(env);
        }
        *finished = env.take_finished();
        self.fill(py, Some(env), &arrays)?;
        Ok(!finished.is_empty())
    }

    /// Returns the worlds whose episodes the last step has ended, and their records as JSON.
    fn finished(&self, py: Python<'_>) -> PyResult<Vec<(usize, String)>> {
        let running = self.lock(py)?;
        let Some(running) = running.as_ref() else { return Ok(Vec::new()) };
        let json = |record: &EpisodeRecord| {
            serde_json::to_string(record).map_err(|error| exception(py, "Error", error.to_string()))
        };
        let world = |episode| running.env.worlds().position(|world| world.episode() == episode);
        let records = running.finished.iter();
        records.map(|record| Ok((world(record.episode).unwrap_or(0), json(record)?))).collect()
    }

    /// Performs the decisions `[T, E, N, A]` one after the other without Python, for benchmarks. Each
    /// step's frames are written to the same arrays.
    fn repeat(
        &self,
        py: Python<'_>,
        actions: PyReadonlyArrayDyn<'_, f32>,
        arrays: Arrays<'_>,
    ) -> PyResult<()> {
        let mut running = self.lock(py)?;
        let Some(running) = running.as_mut() else { return Ok(()) };
        let width = running.actions.len();
        let actions: Vec<f32> = actions.as_array().iter().copied().collect();
        for actions in actions.chunks_exact(width) {
            let taken = detached(py, || running.env.step(actions))?;
            taken.map_err(|error| of_env(py, &error))?;
            self.fill(py, Some(&running.env), &arrays)?;
            running.env.take_finished();
        }
        Ok(())
    }

    /// Returns the numbers of the episodes that the worlds play.
    fn episodes(&self, py: Python<'_>) -> PyResult<Vec<u64>> {
        let running = self.lock(py)?;
        Ok(running.iter().flat_map(|running| running.env.worlds().map(World::episode)).collect())
    }

    /// Returns world 0's episode so far as an HTML player, or as an SVG picture of its present step;
    /// `None` if it is not recorded.
    fn render(&self, py: Python<'_>, html: bool) -> PyResult<Option<String>> {
        Ok(self
            .recording(py)?
            .map(|recording| if html { recording.player() } else { recording.still(usize::MAX) }))
    }

    /// Returns a picture of world 0's present step, `[H, W, 3]`; `None` if it is not recorded.
    fn pixels<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray3<u8>>>> {
        let Some(recording) = self.recording(py)? else { return Ok(None) };
        let drawn = py.detach(|| pixels(&recording.still(usize::MAX)));
        let ([height, width], pixels) =
            drawn.map_err(|error| exception(py, "Error", error.to_string()))?;
        Ok(Some(PyArray::from_vec(py, pixels).reshape([height, width, 3])?))
    }

    /// Writes world 0's episode so far to a file, for `iwol replay`. Returns whether there is
    /// anything to write.
    fn save_recording(&self, py: Python<'_>, path: std::path::PathBuf) -> PyResult<bool> {
        let Some(recording) = self.recording(py)? else { return Ok(false) };
        let saved = recording.save(&path);
        saved.map_err(|error| exception(py, "Error", error.to_string()))?;
        Ok(true)
    }

    /// Ends SUMO. Nothing happens if it does not run.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        // In a forked process SUMO belongs to the parent.
        if is_forked() {
            return Ok(());
        }
        let running = self.lock(py)?.take();
        py.detach(|| drop(running));
        Ok(())
    }
}

impl Drop for NativeEnv {
    fn drop(&mut self) {
        // In a forked process SUMO belongs to the parent.
        if is_forked() {
            let running = self.running.get_mut().unwrap_or_else(PoisonError::into_inner);
            std::mem::forget(running.take());
        }
    }
}

impl NativeEnv {
    fn lock(&self, py: Python<'_>) -> PyResult<MutexGuard<'_, Option<Running>>> {
        match self.running.try_lock() {
            Ok(running) => Ok(running),
            Err(TryLockError::Poisoned(poisoned)) => Ok(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => {
                let text = "the environment is in use by another thread: give each thread its own";
                Err(exception(py, "Error", text.into()))
            }
        }
    }

    /// Copies the actions, whose memory Python may change while Rust works.
    fn take_actions(
        &self,
        py: Python<'_>,
        actions: &Bound<'_, PyArrayDyn<f32>>,
        running: &mut Running,
    ) -> PyResult<()> {
        let (agents, width) = (self.task.agents, self.task.spec.actions.len());
        let wanted = [self.worlds, agents, width];
        let given: PyReadonlyArrayDyn<'_, f32> = actions.try_readonly()?;
        if given.shape() != wanted {
            let text = format!("actions have the shape {:?} instead of {wanted:?}", given.shape());
            return Err(exception(py, "ArgumentError", text));
        }
        let given = given.as_array();
        match given.as_slice() {
            Some(given) => running.actions.copy_from_slice(given),
            None => {
                running.actions.iter_mut().zip(given.iter()).for_each(|(to, from)| *to = *from);
            }
        }
        let rows = running.env.worlds().flat_map(|world| &world.frame().active);
        for (row, (active, action)) in rows.zip(running.actions.chunks_exact_mut(width)).enumerate()
        {
            if *active < 0.5 {
                action.fill(0.0);
            } else if action.iter().any(|value| value.is_nan()) {
                let (e, i) = (row / agents, row % agents);
                let text = format!("the action of vehicle_{i} in environment {e} is NaN");
                return Err(exception(py, "ArgumentError", text));
            }
        }
        Ok(())
    }

    /// Writes the worlds' frames to the arrays. Without worlds, only makes sure that the arrays can
    /// be written.
    fn fill(&self, py: Python<'_>, env: Option<&VecEnv>, arrays: &Arrays<'_>) -> PyResult<()> {
        let (n, spec) = (self.task.agents, &self.task.spec);
        let (o, s) = (spec.observation.len(), spec.state.len());
        let worlds = || env.into_iter().flat_map(VecEnv::worlds);
        let frames = || worlds().map(World::frame);
        let copy = |name: &str, array: &Bound<'_, PyArrayDyn<f32>>, width: usize, of: Numbers| {
            write(py, name, array, self.worlds * n * width, |out| {
                let rows = out.chunks_exact_mut((n * width).max(1));
                rows.zip(frames()).for_each(|(out, frame)| out.copy_from_slice(of(frame)));
            })
        };
        copy("observation", &arrays.observation, o, |frame| &frame.observation)?;
        copy("state", &arrays.state, s, |frame| &frame.state)?;
        copy("comm", &arrays.comm, n, |frame| &frame.comm)?;
        copy("reward", &arrays.reward, 1, |frame| &frame.reward)?;
        let flags = |name: &str, array: &Bound<'_, PyArrayDyn<bool>>, of: Numbers| {
            write(py, name, array, self.worlds * n, |out| {
                let values = frames().flat_map(of);
                out.iter_mut().zip(values).for_each(|(out, value)| *out = *value > 0.5);
            })
        };
        flags("active", &arrays.active, |frame| &frame.active)?;
        flags("terminated", &arrays.terminated, |frame| &frame.terminated)?;
        flags("truncated", &arrays.truncated, |frame| &frame.truncated)?;
        flags("start", &arrays.start, |frame| &frame.start)?;
        write(py, "interrupted", &arrays.interrupted, self.worlds, |out| {
            out.iter_mut().zip(frames()).for_each(|(out, frame)| *out = frame.interrupted);
        })?;
        write(py, "outcome", &arrays.outcome, self.worlds * n * 3, |out| {
            let agents = worlds().flat_map(World::agents);
            for (out, agent) in out.chunks_exact_mut(3).zip(agents) {
                let outcome = agent.outcome;
                out.copy_from_slice(&[outcome.arrived, outcome.crashed, outcome.out_of_road]);
            }
        })
    }

    fn recording(&self, py: Python<'_>) -> PyResult<Option<Recording>> {
        let running = self.lock(py)?;
        let Some(Running { recorder: Some(recorder), seed, env, .. }) = running.as_ref() else {
            return Ok(None);
        };
        let backdrop = self.task.backdrop().map_err(|error| of_env(py, &error))?;
        let environment = &self.task.scenario.name;
        let title = Title { environment, policy: "Python", seed: *seed };
        Ok(recorder.so_far(env, 0, &backdrop, &title))
    }
}

/// The numbers of a frame that an array receives.
type Numbers = fn(&iwol_sumo::env::Frame) -> &[f32];

/// Lets `fill` write the `len` elements of a C-contiguous array.
fn write<T: Element>(
    py: Python<'_>,
    name: &str,
    array: &Bound<'_, PyArrayDyn<T>>,
    len: usize,
    fill: impl FnOnce(&mut [T]),
) -> PyResult<()> {
    let mut array = array.try_readwrite().map_err(|error| {
        exception(py, "Error", format!("the array `{name}` cannot be written: {error}"))
    })?;
    let ordered = array.is_c_contiguous();
    match array.as_slice_mut() {
        Ok(out) if ordered && out.len() == len => {
            fill(out);
            Ok(())
        }
        _ => {
            let text = format!("the array `{name}` must be C-contiguous with {len} elements");
            Err(exception(py, "ArgumentError", text))
        }
    }
}
