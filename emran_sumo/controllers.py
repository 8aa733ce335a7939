"""The controllers by the names users see: each is a set of parameter values of the one coupled scheme."""

_PLAIN_LATERAL = {
    "lateral.feedforward": False,
    "lateral.gain": 2.5,
    "lateral.softening": 0.0,
    "lateral.emran.authority": 0.0,
}
_NO_NETWORKS: dict[str, object] = {"longitudinal.emran.authority": 0.0, "lateral.emran.authority": 0.0}
_PLAIN_LONGITUDINAL = {"longitudinal.feedforward": False, "longitudinal.emran.authority": 0.0}

DEFAULT = "coupled-emran"

# name -> (one line, dotted keys with their values)
CONTROLLERS: dict[str, tuple[str, dict[str, object]]] = {
    "coupled-emran": ("PID cruise and Stanley steering with feed-forward, both aided by EMRAN networks", {}),
    "coupled-base": (
        "the same feed-forward and feedback without the networks",
        _NO_NETWORKS,
    ),
    "pid-stanley": (
        "the paper's baseline: PID cruise and Stanley steering (Eq. 22) alone",
        {**_PLAIN_LONGITUDINAL, **_PLAIN_LATERAL},
    ),
    "pid-emran": ("EMRAN-aided cruise with plain Stanley steering", _PLAIN_LATERAL),
    "stanley-emran": ("EMRAN-aided steering with plain PID cruise", _PLAIN_LONGITUDINAL),
    "coupled-mran": (
        "coupled-emran whose filters correct all neurons at once (MRAN), not the winner alone",
        {"longitudinal.emran.all_neurons": True, "lateral.emran.all_neurons": True},
    ),
    "stanley-hoffmann": (
        "full Stanley law (yaw damping, steady-state yaw), cruise of coupled-base",
        {"lateral.law": "hoffmann", **_NO_NETWORKS},
    ),
    "adrc": ("ADRC steering on a flat output, cruise of coupled-base", {"lateral.law": "adrc", **_NO_NETWORKS}),
    "adrc-emran": ("ADRC steering and the cruise of coupled-base, both aided by EMRAN", {"lateral.law": "adrc"}),
    "lqr": (
        "LQR steering with curvature feed-forward, cruise of coupled-base",
        {"lateral.law": "lqr", **_NO_NETWORKS},
    ),
    "lqr-emran": (
        "LQR steering with feed-forward and the cruise of coupled-base, both aided by EMRAN",
        {"lateral.law": "lqr"},
    ),
    "lq-preview": (
        "LQ steering with preview of the curvature ahead, cruise of coupled-base",
        {"lateral.law": "lq_preview", **_NO_NETWORKS},
    ),
    "lq-preview-emran": (
        "LQ preview steering and the cruise of coupled-base, both aided by EMRAN",
        {"lateral.law": "lq_preview"},
    ),
    "ekf-t2fnn": (
        "type-2 fuzzy neural PID steering with EKF observer (reconstruction), cruise of coupled-base",
        {"lateral.law": "t2fnn", **_NO_NETWORKS},
    ),
}

# of a user's own one: it gets what it asks for; networks and the tires' reach are switched on by their keys. The
# steering network then learns slowly: the rates of the built-in laws are tuned for the loop gain of Stanley
OWN: dict[str, object] = {
    "longitudinal.emran.authority": 0.0,
    "lateral.emran.authority": 0.0,
    "lateral.emran.rate_initial": 0.6,
    "lateral.emran.rate_steady": 0.5,
    "lateral.emran.bias_rate": 0.05,
    "lateral.emran.growth_gain": 0.05,
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
