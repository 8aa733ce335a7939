"""The controllers by the names users see: each is a set of parameter values of the one coupled scheme."""

_PLAIN_LATERAL = {
    "lateral.feedforward": False,
    "lateral.gain": 2.5,
    "lateral.softening": 0.0,
    "lateral.emran.authority": 0.0,
}
_PLAIN_LONGITUDINAL = {"longitudinal.feedforward": False, "longitudinal.emran.authority": 0.0}

DEFAULT = "coupled-emran"

# name -> (one line, dotted keys with their values)
CONTROLLERS: dict[str, tuple[str, dict[str, object]]] = {
    "coupled-emran": ("PID cruise and Stanley steering with feed-forward, both aided by EMRAN networks", {}),
    "coupled-base": (
        "the same feed-forward and feedback without the networks",
        {"longitudinal.emran.authority": 0.0, "lateral.emran.authority": 0.0},
    ),
    "pid-stanley": (
        "the paper's baseline: PID cruise and Stanley steering (Eq. 22) alone",
        {**_PLAIN_LONGITUDINAL, **_PLAIN_LATERAL},
    ),
    "pid-emran": ("EMRAN-aided cruise with plain Stanley steering", _PLAIN_LATERAL),
    "stanley-emran": ("EMRAN-aided steering with plain PID cruise", _PLAIN_LONGITUDINAL),
}

# of a user's own one: it gets what it asks for; networks and the tires' reach are switched on by their keys
OWN: dict[str, object] = {
    "longitudinal.emran.authority": 0.0,
    "lateral.emran.authority": 0.0,
    "lateral.slip_limit": 2.0,
}


def is_own(name: str) -> bool:
    """Whether a controller is a user's own, `module:factory`."""
    return ":" in name


def preset(name: str) -> dict[str, object]:
    """Dotted keys of a controller with their values."""
    return OWN if is_own(name) else CONTROLLERS[name][1]


def label(name: str) -> str:
    """A controller's name for files and tables: `laws/mine.py:Law` is laws.mine.Law."""
    module, colon, factory = name.rpartition(":")
    if not colon:
        return name
    plain = "".join(c if c.isalnum() or c in "-_." else "." for c in module.removesuffix(".py"))
    return f"{plain.strip('.')}.{factory}"
