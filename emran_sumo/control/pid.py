"""PID with a filtered derivative and anti-windup by back-calculation."""

from typing import Annotated, NamedTuple

from pydantic import Field

from emran_sumo.kernels import njit
from emran_sumo.units import Unit


class PidParams(NamedTuple):
    """Gains on the speed error; the command is an acceleration.  Defaults: section IV-A of the paper."""

    K_P: Annotated[float, Field(ge=0, le=50), Unit("1/s")] = 1.841
    K_I: Annotated[float, Field(ge=0, le=50), Unit("1/s^2")] = 2.603
    K_D: Annotated[float, Field(ge=0, le=50), Unit("-")] = 0.682
    derivative_lag: Annotated[float, Field(gt=0, le=1), Unit("s")] = 0.05
    anti_windup: Annotated[float, Field(ge=0, le=50), Unit("1/s")] = 2.0


class PidMemory(NamedTuple):
    """integral [m/s2], filtered derivative term [m/s2], last error [m/s]."""

    integral: float
    derivative: float
    error: float


@njit
def pid(params, memory, error, excess, period):
    """Acceleration command that drives the speed error to zero.

        u = K_P e + I + D,   dI/dt = K_I e + (achieved - asked) anti_windup,   D = K_D s / (T s + 1) e

    Args:
        params: PidParams.
        memory: PidMemory of the last call.
        error: speed reference minus speed [m/s].
        excess: achieved minus asked acceleration [m/s2]; 0 while the actuator follows.
        period: time since the last call [s].

    Returns:
        (acceleration [m/s2], PidMemory)

    Source: paper, section III-C and IV-A.  Differs: the form of the PID is not stated there; the derivative is
    filtered and the integral is bounded by back-calculation.
    """
    integral = memory.integral + (params.K_I * error + params.anti_windup * excess) * period
    lag = params.derivative_lag
    derivative = (lag * memory.derivative + params.K_D * (error - memory.error)) / (lag + period)
    return params.K_P * error + integral + derivative, PidMemory(integral, derivative, error)
