"""The Python side of the libsumo backend: `src/sumo/libsumo.rs` holds this file and runs it in process.

One call of `step` carries out all calls of a decision, takes the step and returns what the environments need, so that
the boundary between Rust and Python is crossed once. Calls have the names and arguments that they have in TraCI. They
come in runs of one name, as columns, which `map` feeds to libsumo's functions without a Python loop; those of the
extension module itself are used, because the ones of the package `libsumo` are Python functions around them.
"""

import os
from collections import deque
from functools import cache
from operator import length_hint

sumo_home = os.environ.get("SUMO_HOME")
import libsumo  # noqa: E402

# The import sets SUMO_HOME, by which this program finds SUMO, to a folder without programs.
os.environ.pop("SUMO_HOME", None)
if sumo_home is not None:
    os.environ["SUMO_HOME"] = sumo_home

from libsumo.libsumo import _libsumo as native  # noqa: E402


def add_person(name, kind, edge, depart, position):
    native.person_add(name, edge, position, depart, kind)


def append_walk(name, _stage, *walk):
    native.person_appendWalkingStage(name, *walk)


# Calls whose arguments libsumo takes in another order than TraCI.
OTHERS = {"person.add": add_person, "person.appendWalkingStage": append_walk}


@cache
def function(call):
    """Returns libsumo's function for a call, such as `vehicle.setSpeed`."""
    return OTHERS.get(call) or getattr(native, call.replace(".", "_"))


distance_of = native.vehicle_getDistance
speed_of = native.vehicle_getSpeed
position_of = native.vehicle_getPosition
angle_of = native.vehicle_getAngle
lane_of = native.vehicle_getLaneID
time_loss_of = native.vehicle_getTimeLoss
arrived_ids = native.simulation_getArrivedIDList
arrived_persons = native.simulation_getArrivedPersonIDList
persons_now = native.person_getIDList
collisions_now = native.simulation_getCollisions
light_state = native.trafficlight_getRedYellowGreenState
light_phase = native.trafficlight_getPhase
light_switch = native.trafficlight_getNextSwitch
time_now = native.simulation_getTime
take_step = native.simulation_step

Refused = libsumo.TraCIException


def version():
    """Returns SUMO's TraCI version and name."""
    return libsumo.getVersion()


def start(arguments):
    """Starts the simulation; `arguments` are those of the program `sumo`. Returns SUMO's TraCI version and name."""
    libsumo.start(["sumo", *arguments])
    return version()


def load(arguments):
    """Replaces the simulation by a fresh one."""
    libsumo.load(arguments)


def close():
    libsumo.close()


def carry_out(runs):
    """Carries out `runs`, a list of (call, [objects, columns…]), and passes over refused calls.

    Returns the refusals as (index of the call, text), and the vehicles and persons that were not added.
    """
    refusals = []
    unknown = set()
    start = 0
    for call, (names, *columns) in runs:
        rest = iter(names)
        calls = map(function(call), rest, *columns)
        while True:
            try:
                deque(calls, maxlen=0)
                break
            except Refused as refused:
                index = len(names) - length_hint(rest) - 1
                refusals.append((start + index, str(refused)))
                if call in ("vehicle.add", "person.add"):
                    unknown.add(names[index])
        start += len(names)
    return refusals, unknown


def is_unknown(vehicle):
    try:
        distance_of(vehicle)
    except Refused:
        return True
    return False


def step(runs, vehicles, others, persons, lights):
    """Carries out `runs` as `carry_out` does, and takes one step.

    Returns the time, the vehicles and persons that arrived or were refused and the vehicles that libsumo dropped when
    they were to enter the road, the distances and speeds of the other
    `vehicles` in their order, the pairs of colliding vehicles and the refusals, if there are `others` that SUMO
    drives, positions, angles, lanes and time losses of the vehicles, and position, angle and speed of each of the `persons`,
    or None where there is none of that name, and state, phase and time of the next switch of each of the traffic `lights`.
    """
    refusals, unknown = carry_out(runs)
    take_step(0.0)
    unknown.update(arrived_ids())
    if unknown:
        vehicles = [name for name in vehicles if name not in unknown]
    dropped = []
    try:
        distances = list(map(distance_of, vehicles))
    except Refused:
        dropped = [name for name in vehicles if is_unknown(name)]
        vehicles = [name for name in vehicles if name not in dropped]
        distances = list(map(distance_of, vehicles))
    collisions = [(c.collider, c.victim) for c in collisions_now()]
    bodies = ([], [], [], [])
    if others:
        bodies = tuple(list(map(of, vehicles)) for of in (position_of, angle_of, lane_of, time_loss_of))
    speeds = list(map(speed_of, vehicles))
    walkers = []
    if persons:
        unknown.update(arrived_persons())
        there = set(persons_now())
        walkers = [
            (native.person_getPosition(name), native.person_getAngle(name), native.person_getSpeed(name))
            if name in there
            else None
            for name in persons
        ]
    signals = [(light_state(name), light_phase(name), light_switch(name)) for name in lights]
    return time_now(), [list(unknown), dropped], distances, speeds, (collisions, refusals), bodies, walkers, signals
