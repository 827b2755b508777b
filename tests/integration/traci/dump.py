"""Reads every variable of a simulation with SUMO's own client and writes the values as JSON.

Arguments: seconds to simulate, then SUMO's command line. Floating-point numbers become the
hexadecimal digits of their bits. Keys are `domain.method object`, with the method's name in snake
case.
"""
import inspect
import json
import os
import re
import struct
import sys

sys.path.insert(0, os.path.join(os.environ["SUMO_HOME"], "tools"))
import traci  # noqa: E402
from traci.domain import Domain  # noqa: E402

# Domains whose variables are read. The variables of `gui` need a window.
DOMAINS = (
    "busstop calibrator chargingstation edge inductionloop junction lane lanearea meandata multientryexit overheadwire "
    "parkingarea person poi polygon rerouter route routeprobe simulation trafficlight variablespeedsign vehicle "
    "vehicletype"
).split()

# Arguments besides the object, including those for which Python has a default.
ARGUMENTS = {
    "edge": {"getAdaptedTraveltime": [60.0], "getEffort": [60.0]},
    "junction": {"getPosition": [False]},
    "lane": {"getFoes": ["ce_1"], "getLinks": [True]},
    "trafficlight": {
        "getServedPersonCount": [0],
        "getBlockingVehicles": [0],
        "getRivalVehicles": [0],
        "getPriorityVehicles": [0],
        "getConstraints": [""],
        "getConstraintsByFoe": [""],
    },
    "person": {"getEdges": [0], "getStage": [0]},
    "vehicle": {
        "getAdaptedTraveltime": [60.0, "ce"],
        "getEffort": [60.0, "ce"],
        "getLeader": [100.0],
        "getFollower": [100.0],
        "getRightFollowers": [False],
        "getRightLeaders": [False],
        "getLeftFollowers": [False],
        "getLeftLeaders": [True],
        "getNeighbors": [2],
        "getFollowSpeed": [10.0, 20.0, 5.0, 4.5, ""],
        "getSecureGap": [10.0, 5.0, 4.5, ""],
        "getStopSpeed": [10.0, 20.0],
        "getStops": [0],
        "getDrivingDistance": ["ce", 30.0, 1],
        "getDrivingDistance2D": [800.0, 195.0],
        "getStopParameter": [0, "duration"],
        "getLaneChangeState": [1],
        "getLaneChangeStatePretty": [-1],
        "couldChangeLane": [1, None],
        "wantsAndCouldChangeLane": [-1, None],
    },
}
# Calls that take no object: those of the simulation as a whole, and some of other domains.
ALONE = {
    "vehicle": {"getTaxiFleet": [-1]},
    "person": {"getTaxiReservations": [0]},
    "simulation": {
        "getBusStopWaiting": ["stop"],
        "getBusStopWaitingIDList": ["stop"],
        "getOption": ["seed"],
        "convert2D": ["wc", 10.0, 1, False],
        "convert3D": ["wc", 10.0, 1, True],
        "convertRoad": [700.0, 195.0, False, "passenger"],
        "convertGeo": [700.0, 195.0, False],
        "getDistance2D": [600.0, 195.0, 800.0, 195.0, False, True],
        "getDistanceRoad": ["wc", 10.0, "ce", 30.0, True],
        "findRoute": ["wc", "ce", "car", -1.0, 0],
        "findIntermodalRoute": ["wc", "ce", "", -1.0, 0, -1.0, -1.0, 10.0, 50.0, 0.0, "", "", ""],
    },
}
# Arguments of calls that all domains have.
COMMON = {"getParameter": ["key"], "getParameterWithKey": ["key"]}
READS = re.compile("(get|is|has|could|wants)[A-Z]")
NOT_VARIABLES = re.compile("get.*SubscriptionResults$")


def snake(name):
    """Returns the name of the Rust method: `getCO2Emission` becomes `get_co2_emission`,
    `getLastStepVehicleIDs` becomes `get_last_step_vehicle_ids`."""
    name = name.replace("2D", "2d").replace("3D", "3d")
    for word in ("TraCI", "PMx", "NOx", "IDs", "VClass", "VType", "ToC"):
        name = name.replace(word, word.capitalize())
    name = re.sub("([a-z0-9])([A-Z])", r"\1_\2", name)
    name = re.sub("([A-Z]+)([A-Z][a-z])", r"\1_\2", name)
    return name.lower()


def plain(value):
    if isinstance(value, float):
        return struct.pack("!d", value).hex()
    if isinstance(value, dict):
        return [[plain(k), plain(v)] for k, v in value.items()]
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if hasattr(value, "__dict__"):
        return [plain(v) for v in vars(value).values()]
    return value


def ask(domain, method, arguments):
    try:
        answer = plain(getattr(domain, method)(*arguments))
    except traci.exceptions.TraCIException as error:
        return "refused: " + str(error)
    except struct.error:
        assert method == "getShape"  # Python's client cannot read a shape without points.
        return []
    if method == "getFollower" and answer[0] == "":
        return None  # The value that `getLeader` returns if there is no vehicle.
    return answer


def main():
    traci.start(sys.argv[2:])
    traci.simulationStep(float(sys.argv[1]))
    values, methods = {}, {}
    for domain in traci.connection.DOMAINS:
        kind, name = type(domain), domain._name
        domain = getattr(traci, name)
        public = [m for m, _ in inspect.getmembers(kind, callable) if re.match("[a-z]", m)]
        methods[name] = {m: snake(m) for m in public}
        if name not in DOMAINS:
            continue
        alone = name == "simulation"
        objects = [] if alone else list(domain.getIDList())
        for method in public:
            if not READS.match(method) or NOT_VARIABLES.search(method) or "RedYellowGreenDefinition" in method:
                continue
            key = "%s.%s" % (name, snake(method))
            arguments = COMMON.get(method) or ARGUMENTS.get(name, {}).get(method, [])
            # The count includes `self` and, for most calls, the object.
            parameters = inspect.signature(getattr(kind, method)).parameters.values()
            count, needed = len(parameters), sum(p.default is inspect.Parameter.empty for p in parameters)
            if method in ALONE.get(name, {}):
                values[key] = ask(domain, method, ALONE[name][method])
            elif count == 1:
                values[key] = ask(domain, method, [])
            else:
                # Later releases have more parameters, with defaults, and more calls, which are left out.
                if not needed - 2 <= len(arguments) <= count - 2:
                    values[key] = "takes %d arguments" % (count - 2)
                    continue
                for object in [""] if alone else objects:
                    values[key + " " + object] = ask(domain, method, [object] + arguments)
        if alone:
            for method in ALONE[name]:
                if not READS.match(method):
                    values["%s.%s" % (name, snake(method))] = ask(domain, method, ALONE[name][method])
    traci.close()
    json.dump({"values": values, "methods": methods}, sys.stdout)


main()
