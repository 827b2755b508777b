"""The exceptions of the package. Their texts name the cause, the place, and what to do."""


class Error(Exception):
    """An error of an environment."""


class ArgumentError(Error, ValueError):
    """An argument has a value that is not allowed."""


class ScenarioError(Error, ValueError):
    """A scenario, its net or its route files cannot be used."""


class SumoError(Error, RuntimeError):
    """SUMO cannot be started, or failed."""
