#!/usr/bin/python3
"""Plays a workload through SUMO's own Python clients and prints how long it took, as one line of JSON.

The workload is the JSON file that `iwol` writes for such comparisons: SUMO's arguments, the vehicle types and
routes, and the commands of every simulation step. Each client sends the same commands and, after every step, reads
the time, the number of colliding vehicles, and the position, angle and speed of every vehicle on the road.

  traci       TraCI, one call per value
  subscribed  TraCI, variable subscriptions
  libsumo     libsumo in process, one call per value (with subscriptions it took about 15 % longer)
"""

import argparse
import contextlib
import gc
import json
import os
import subprocess
import sys
import time
from pathlib import Path

REMOVE_VAPORIZED = 3
VAR_POSITION, VAR_ANGLE, VAR_SPEED = 0x42, 0x43, 0x40
VAR_TIME, VAR_COLLIDING_VEHICLES_NUMBER = 0x66, 0x80
# What SUMO reports of a vehicle that waits to be put on the road.
INVALID = -(2.0**30)


def start(client, binary, arguments):
    """Starts SUMO; returns the client's module and what SUMO calls its version."""
    if client == "libsumo":
        import libsumo

        return libsumo, libsumo.start([binary, *arguments])[1]
    sys.path.append(os.path.join(os.environ.get("SUMO_HOME", "/usr/share/sumo"), "tools"))
    import traci

    return traci, traci.start([binary, *arguments], stdout=subprocess.DEVNULL)[1]


def introduce(sumo, workload):
    """Makes the vehicle types and routes known."""
    kinds = sumo.vehicletype
    for kind in workload["vehicle_types"]:
        name = kind["id"]
        kinds.copy("DEFAULT_VEHTYPE", name)
        kinds.setLength(name, kind["length"])
        kinds.setWidth(name, kind["width"])
        kinds.setMinGap(name, kind["min_gap"])
        kinds.setMaxSpeed(name, kind["max_speed"])
        kinds.setAccel(name, kind["accel"])
        kinds.setEmergencyDecel(name, kind["emergency_decel"])
        kinds.setDecel(name, kind["decel"])
        kinds.setTau(name, kind["tau"])
        kinds.setImperfection(name, 0.0)
        kinds.setSpeedFactor(name, 1.0)
        kinds.setSpeedDeviation(name, 0.0)
    for route in workload["routes"]:
        sumo.route.add(route["id"], route["edges"])


def calls(sumo, workload, steps, subscribed):
    """For each of the steps, its commands as pairs of a function and its arguments."""
    vehicles = workload["vehicles"]
    routes = [route["id"] for route in workload["routes"]]
    kinds = [kind["id"] for kind in workload["vehicle_types"]]
    cars = sumo.vehicle

    def translate(command):
        name, index, *rest = command
        vehicle = vehicles[index]
        if name == "speed":
            yield cars.setSpeed, (vehicle, float(rest[0]))
        elif name == "move":
            x, y, angle, keep_route = rest
            yield cars.moveToXY, (vehicle, "", -1, float(x), float(y), float(angle), keep_route)
        elif name == "speed_mode":
            yield cars.setSpeedMode, (vehicle, rest[0])
        elif name == "lane_change_mode":
            yield cars.setLaneChangeMode, (vehicle, rest[0])
        elif name == "add":
            route, kind, pos, speed = rest
            departure = ("now", "first", repr(float(pos)), repr(float(speed)))
            yield cars.add, (vehicle, routes[route], kinds[kind], *departure)
            if subscribed:
                yield cars.subscribe, (vehicle, (VAR_POSITION, VAR_ANGLE, VAR_SPEED))
        elif name == "remove":
            if subscribed:
                # Ended first, because SUMO complains of a subscription whose vehicle is gone.
                yield cars.unsubscribe, (vehicle,)
            yield cars.remove, (vehicle, REMOVE_VAPORIZED)
        else:
            raise ValueError(f"unknown command {name!r}")

    return [[call for command in step for call in translate(command)] for step in steps]


def getters(sumo):
    """Reads with one call per value; returns the sum of what was read of the vehicles."""
    on_road = sumo.vehicle.getIDList
    position, angle, speed = sumo.vehicle.getPosition, sumo.vehicle.getAngle, sumo.vehicle.getSpeed
    now, colliding = sumo.simulation.getTime, sumo.simulation.getCollidingVehiclesNumber

    def read():
        now()
        colliding()
        total = 0.0
        for vehicle in on_road():
            x, y = position(vehicle)
            total += x + y + angle(vehicle) + speed(vehicle)
        return total

    return read


def subscriptions(sumo):
    """Reads what the subscriptions brought; returns the sum of what was read of the vehicles."""
    sumo.simulation.subscribe((VAR_TIME, VAR_COLLIDING_VEHICLES_NUMBER))
    of_simulation = sumo.simulation.getSubscriptionResults
    of_vehicles = sumo.vehicle.getAllSubscriptionResults

    def read():
        simulation = of_simulation()
        simulation[VAR_TIME]
        simulation[VAR_COLLIDING_VEHICLES_NUMBER]
        total = 0.0
        for values in of_vehicles().values():
            x, y = values[VAR_POSITION]
            if x != INVALID:
                total += x + y + values[VAR_ANGLE] + values[VAR_SPEED]
        return total

    return read


def play(client, binary, workload, limit):
    """Plays the workload; returns what is to be printed."""
    sumo, version = start(client, binary, workload["arguments"])
    try:
        introduce(sumo, workload)
        subscribed = client == "subscribed"
        step, read = sumo.simulationStep, subscriptions(sumo) if subscribed else getters(sumo)

        def run(steps):
            checksum = 0.0
            for commands in steps:
                for call, arguments in commands:
                    call(*arguments)
                step()
                checksum += read()
            return checksum

        warmup = workload["warmup"]
        steps = workload["steps"] if limit is None else workload["steps"][: warmup + limit]
        steps = calls(sumo, workload, steps, subscribed)
        timed = steps[warmup:]
        # The commands to come are no garbage to be looked through while the clock runs.
        gc.freeze()
        run(steps[:warmup])
        started, started_cpu = time.perf_counter(), time.process_time()
        checksum = run(timed)
        seconds, seconds_cpu = time.perf_counter() - started, time.process_time() - started_cpu
    finally:
        sumo.close()
    return {
        "client": client,
        "version": version,
        "steps": len(timed),
        "seconds": seconds,
        "seconds_cpu": seconds_cpu,
        "checksum": checksum,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("client", choices=["traci", "subscribed", "libsumo"])
    parser.add_argument("workload", type=Path)
    parser.add_argument("--steps", type=int, metavar="N", help="play only the first N timed steps")
    parser.add_argument("--sumo", default="sumo", metavar="FILE", help="SUMO's program")
    parser.add_argument("--packages", metavar="FOLDER", help="where to look for the module libsumo first")
    options = parser.parse_args()
    if options.packages:
        sys.path.insert(0, options.packages)
    try:
        # The clients write to standard output, where only the result belongs.
        with contextlib.redirect_stdout(sys.stderr):
            workload = json.loads(options.workload.read_text())
            result = play(options.client, options.sumo, workload, options.steps)
    except Exception as error:
        sys.exit(f"players.py: {type(error).__name__}: {error}")
    print(json.dumps(result))


if __name__ == "__main__":
    main()
