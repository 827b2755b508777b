"""The Python side of the libsumo backend: `src/sumo/libsumo.rs` holds this file and runs it in process.

One call of `step` carries out all commands of a decision, takes the step and returns what the environments need, so
that the boundary between Rust and Python is crossed once. Commands come in runs of one kind, as columns, which `map`
feeds to libsumo's functions without a Python loop; those of the extension module itself are used, because the ones of
the package `libsumo` are Python functions around them.
"""

from collections import deque
from itertools import repeat
from operator import length_hint

import libsumo
from libsumo.libsumo import _libsumo as native



def add_person(name, kind, edges, position, arrival):
    native.person_add(name, edges[0], position, DEPART_NOW, kind)
    native.person_appendWalkingStage(name, edges, arrival, -1.0, -1.0, "")


DEPART_NOW = -3.0
SET = {
    "vehicle.add": native.vehicle_add,
    "vehicle.remove": native.vehicle_remove,
    "vehicle.setSpeed": native.vehicle_setSpeed,
    "vehicle.setSpeedMode": native.vehicle_setSpeedMode,
    "vehicle.setLaneChangeMode": native.vehicle_setLaneChangeMode,
    "vehicle.moveToXY": native.vehicle_moveToXY,
    "person.add": add_person,
    "person.remove": native.person_remove,
    "person.setSpeed": native.person_setSpeed,
}
distance_of = native.vehicle_getDistance
speed_of = native.vehicle_getSpeed
position_of = native.vehicle_getPosition
angle_of = native.vehicle_getAngle
time_loss_of = native.vehicle_getTimeLoss
arrived_ids = native.simulation_getArrivedIDList
arrived_persons = native.simulation_getArrivedPersonIDList
persons_now = native.person_getIDList
collisions_now = native.simulation_getCollisions
time_now = native.simulation_getTime
take_step = native.simulation_step

Refused = libsumo.TraCIException

TYPE_SETTERS = (
    ("length", native.vehicletype_setLength),
    ("width", native.vehicletype_setWidth),
    ("min_gap", native.vehicletype_setMinGap),
    ("max_speed", native.vehicletype_setMaxSpeed),
    ("accel", native.vehicletype_setAccel),
    # Before the comfortable one, which may not exceed it.
    ("emergency_decel", native.vehicletype_setEmergencyDecel),
    ("decel", native.vehicletype_setDecel),
    ("tau", native.vehicletype_setTau),
    ("imperfection", native.vehicletype_setImperfection),
    ("speed_factor", native.vehicletype_setSpeedFactor),
    ("speed_deviation", native.vehicletype_setSpeedDeviation),
)


def start(arguments):
    """Starts the simulation; `arguments` are those of the program `sumo`. Returns SUMO's TraCI version and name."""
    libsumo.start(["sumo", *arguments])
    return libsumo.getVersion()


def load(arguments):
    """Replaces the simulation by a fresh one."""
    libsumo.load(arguments)


def close():
    libsumo.close()


def introduce(types, routes):
    """Makes vehicle types (dictionaries) and routes (identifier, edges) known. Returns a refusal or None."""
    for kind in types:
        native.vehicletype_copy("DEFAULT_VEHTYPE", kind["id"])
        for key, setter in TYPE_SETTERS:
            setter(kind["id"], kind[key])
    for identifier, edges in routes:
        try:
            native.route_add(identifier, edges)
        except Refused as refusal:
            return identifier, str(refusal)
    return None


def step(orders, vehicles, others, persons):
    """Carries out `orders`, a list of (call, columns…) with the vehicles as first column, and takes one step.

    Returns the time, the vehicles and persons that arrived or were refused, the distances and speeds of the other `vehicles` in their
    order, the pairs of colliding vehicles, the first refusal as (call, vehicle, text) or None, if there are `others` that SUMO drives,
    positions, angles and time losses of the vehicles, and position, angle and speed of each of the `persons`, or None where there is
    none of that name. A refused command is passed over.
    """
    refusal = None
    unknown = set()
    for call, names, *columns in orders:
        if call == "vehicle.add":
            routes, types, lanes, positions, speeds = columns
            columns = routes, types, repeat("now"), lanes, positions, speeds
        elif call == "vehicle.moveToXY":
            # No edge is hinted at, and no lane of it.
            columns = repeat(""), repeat(-1), *columns
        rest = iter(names)
        calls = map(SET[call], rest, *columns)
        while True:
            try:
                deque(calls, maxlen=0)
                break
            except Refused as refused:
                name = names[len(names) - length_hint(rest) - 1]
                if refusal is None:
                    refusal = call, name, str(refused)
                if call in ("vehicle.add", "person.add"):
                    unknown.add(name)
    take_step(0.0)
    unknown.update(arrived_ids())
    if unknown:
        vehicles = [name for name in vehicles if name not in unknown]
    collisions = [(c.collider, c.victim) for c in collisions_now()]
    bodies = ([], [], [])
    if others:
        bodies = list(map(position_of, vehicles)), list(map(angle_of, vehicles)), list(map(time_loss_of, vehicles))
    distances, speeds = list(map(distance_of, vehicles)), list(map(speed_of, vehicles))
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
    return time_now(), list(unknown), distances, speeds, collisions, refusal, bodies, walkers
