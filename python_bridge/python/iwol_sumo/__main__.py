"""``python -m iwol_sumo`` says which SUMO the package uses, and which scenarios it has."""

from __future__ import annotations

import sys

from . import SumoError, __version__, _native, scenarios


def main() -> int:
    print(f"iwol_sumo {__version__}, Python {sys.version.split()[0]}")
    try:
        program, reason, version = _native.sumo()
    except SumoError as error:
        print(f"SUMO: {error}", 'install it with: pip install eclipse-sumo', sep="\n")
        return 1
    print(f"SUMO: {version}, {program} ({reason})")
    print("scenarios:", ", ".join(scenarios()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
