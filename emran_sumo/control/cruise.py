"""Cruise control: the PID of the paper alone, or in the full scheme with feed-forward, lag compensation and EMRAN."""

import math
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from emran_sumo.control.emran import EmranParams, learn, learn_bias, predict, prune
from emran_sumo.control.pid import PidMemory, PidParams, pid
from emran_sumo.kernels import njit
from emran_sumo.plant.records import GRAVITY
from emran_sumo.units import Unit

INPUTS = 3  # speed reference, acceleration reference, grade acceleration
HOLD_SPEED = 0.3  # m/s: below it, with a reference of standstill, the brakes hold the car
LEARNING_SPEED = 1.0  # m/s: below it brakes hold the car with more torque than it shows
HOLD_DECELERATION = 1.5  # m/s2, on top of what the grade needs


class CruiseParams(NamedTuple):
    """The longitudinal law and its network.

    preview: how far ahead the acceleration reference is read where the profile is known.

    With `feedforward` off only the PID acts, on the measured speed: the paper's baseline. Its network then learns the
    paper's own signal u_pid + paper_gain e from the raw inputs position, speed and acceleration.
    """

    feedforward: Annotated[bool, Unit("on/off")] = True
    paper_gain: Annotated[float, Field(ge=0, le=50), Unit("1/s")] = 1.0
    K_1: Annotated[float, Field(ge=0, le=50), Unit("1/s")] = 2.3538
    lag: Annotated[float, Field(gt=0, le=2), Unit("s")] = 0.1
    lead_filter: Annotated[float, Field(gt=0, le=2), Unit("s")] = 0.038979
    preview: Annotated[float, Field(ge=0, le=1), Unit("s")] = 0.04378
    grade_lead: Annotated[float, Field(ge=0, le=1), Unit("s")] = 0.044964
    observer_speed: Annotated[float, Field(ge=0, le=90), Unit("1/s")] = 4.0
    observer_grade: Annotated[float, Field(ge=0, le=90), Unit("1/s^2")] = 4.0
    accel_max: Annotated[float, Field(gt=0, le=12), Unit("m/s^2")] = 7.0
    decel_max: Annotated[float, Field(gt=0, le=12), Unit("m/s^2")] = 9.0
    speed_scale: Annotated[float, Field(ge=0, le=100), Unit("s/m")] = 0.1856
    accel_scale: Annotated[float, Field(ge=0, le=100), Unit("s^2/m")] = 1.3665
    grade_scale: Annotated[float, Field(ge=0, le=100), Unit("s^2/m")] = 0.14665
    pid: PidParams = PidParams()
    emran: EmranParams = EmranParams(
        eps_max=0.8476,
        eps_min=0.4238,
        gamma=0.99,
        error_delete=0.0044,
        error_learn=0.00889,
        error_grow=0.01664,
        rms_grow=0.03,
        window=5,
        overlap=0.8564,
        growth_gain=0.5067,
        rate_initial=18.27,
        rate_steady=6.233,
        shape_gain=7.3e-4,
        bias_rate=5.0,
        leak=0.0,
        width_min=0.15,
        width_max=3.0,
        center_step=0.2,
        output_max=12.0,
        prune_share=0.0,
        merge_distance=0.127,
    )


class CruiseMemory(NamedTuple):
    """Estimated speed [m/s] and grade acceleration g sin(grade) [m/s2], last specific force [m/s2], states of the
    lead filter (asked and filtered [m/s2]), what the lagged drive would give of the unlimited command [m/s2], and the
    PID's memory."""

    speed: float
    grade_accel: float
    specific_force: float
    asked: float
    led: float
    expected: float
    pid: PidMemory


class Motion(NamedTuple):
    """What the sensors of the longitudinal law say.

    speed [m/s]; specific_force [m/s2] along the body, without the centripetal part v_y r; pitch_rate [rad/s];
    achieved [m/s2]: acceleration the wheels' torque would give on its own; position [m] along the path.
    """

    speed: float
    specific_force: float
    pitch_rate: float
    achieved: float
    position: float


class CruiseCommand(NamedTuple):
    """Acceleration asked [m/s2] with its parts from the law and the network, and the learning signal [m/s2]."""

    accel: float
    law: float
    network: float
    signal: float
    learned: bool


def rolling_memory(speed: float, motion: Motion, resistance: float) -> CruiseMemory:
    """Memory of a law that takes over at `speed` [m/s] while the drive balances `resistance` [m/s2]."""
    at = motion.achieved
    return CruiseMemory(speed, 0.0, motion.specific_force, at, at, at, PidMemory(resistance, 0.0, 0.0))


@njit
def resistance(vehicle, speed):
    """Acceleration [m/s2] that drag and rolling take at `speed` [m/s] on the flat."""
    drag = 0.5 * vehicle.air_density * vehicle.drag_area * speed * speed / vehicle.mass
    return drag + vehicle.rolling_resistance * GRAVITY * math.tanh(speed / 0.3)


@njit
def observe(params, memory, motion, period):
    """Speed [m/s] and grade acceleration [m/s2], predicted, corrected by wheel speed, accelerometer, pitch gyro."""
    b = memory.grade_accel
    b += period * motion.pitch_rate * math.sqrt(max(GRAVITY * GRAVITY - b * b, 0.0))
    v = memory.speed + period * (0.5 * (motion.specific_force + memory.specific_force) - b)
    r = motion.speed - v
    return v + period * params.observer_speed * r, b - period * params.observer_grade * r


@njit
def _inputs(params, speed, accel, grade_accel):
    v = np.empty(INPUTS)
    v[0] = params.speed_scale * speed
    v[1] = params.accel_scale * accel
    v[2] = params.grade_scale * grade_accel
    return v


@njit
def cruise(params, network, vehicle, memory, motion, speed_reference, accel_reference, period):
    """Acceleration command that makes the speed follow its reference.

        u = lead( u_ff + u_pid + K_1 e + u_nn )                                                      (21)
        u_ff = dv_r/dt + drag + rolling + g sin(grade)
        y_e = (u_achieved - dv/dt) - resistances - u_nn      what the inverse model still misses

    The network learns the difference between the acceleration the wheels were given and the acceleration the car
    took, at the operating point where it happened, and is asked at the operating point that is wanted.

    Args:
        params: CruiseParams.
        network: EmranMemory with 3 inputs, changed in place.
        vehicle: VehicleParams the law believes in.
        memory: CruiseMemory of the last call.
        motion: Motion, the measurements.
        speed_reference: v_r [m/s] now.
        accel_reference: dv_r/dt [m/s2], ahead by the lag where the reference is known ahead.
        period: control period [s].

    Returns:
        (CruiseCommand, CruiseMemory)

    Source: paper, section III-C, Eq. 21 (Gomi and Kawato's feedback-error learning).  Differs: the paper learns
    u_pid + K_1 e, an integral of the error with a stability bound on its rate; here the torque is measured, so the
    missing acceleration itself is the signal and K_1 e acts in the command.
    """
    if params.feedforward:
        return _full(params, network, vehicle, memory, motion, speed_reference, accel_reference, period)
    return _plain(params, network, memory, motion, speed_reference, period)


@njit
def _plain(params, network, memory, motion, speed_reference, period):
    """The paper's own scheme: PID, and a network that learns u_pid + K e."""
    emran = params.emran
    error = speed_reference - motion.speed
    law, pid_memory = pid(params.pid, memory.pid, error, motion.achieved - memory.expected, period)
    net, signal, learned = 0.0, 0.0, False
    if emran.authority > 0.0 and motion.speed > LEARNING_SPEED:
        inputs = np.empty(INPUTS)
        inputs[0], inputs[1], inputs[2] = motion.position, motion.speed, motion.specific_force
        signal = law + params.paper_gain * error
        output = predict(emran, network, inputs)
        if abs(output) < emran.output_max or output * signal < 0.0:
            learned = learn(emran, network, inputs, signal, 1.0, period)
            if learned:
                learn_bias(emran, network, signal, 1.0, period)
        net = emran.authority * predict(emran, network, inputs)
        prune(emran, network, inputs)
    law, net, pid_memory = _hold(speed_reference, motion.speed, 0.0, law, net, pid_memory)
    asked = law + net
    command = CruiseCommand(_limited(params, asked), law, net, signal, learned)
    expected = memory.expected + period / (params.lag + period) * (asked - memory.expected)
    return command, CruiseMemory(motion.speed, 0.0, motion.specific_force, asked, asked, expected, pid_memory)


@njit
def _full(params, network, vehicle, memory, motion, speed_reference, accel_reference, period):
    v, b = observe(params, memory, motion, period)
    known = resistance(vehicle, speed_reference)
    pitching = motion.pitch_rate * math.sqrt(max(GRAVITY * GRAVITY - b * b, 0.0))
    ahead = b + params.grade_lead * pitching
    net, signal, learned = missing_accel(
        params, network, vehicle, motion, speed_reference, accel_reference, b, ahead, period
    )
    error = speed_reference - v
    feedback, pid_memory = pid(params.pid, memory.pid, error, motion.achieved - memory.expected, period)
    law = accel_reference + known + ahead + feedback + params.K_1 * error
    law, net, pid_memory = _hold(speed_reference, motion.speed, b, law, net, pid_memory)
    asked = law + net
    # lead (lag s + 1) / (lead_filter s + 1) against the lag of the drive
    tau = params.lead_filter
    led = (tau * memory.led + period * asked + params.lag * (asked - memory.asked)) / (tau + period)
    expected = memory.expected + period / (params.lag + period) * (led - memory.expected)
    command = CruiseCommand(_limited(params, led), law, net, signal, learned)
    return command, CruiseMemory(v, b, motion.specific_force, asked, led, expected, pid_memory)


@njit
def missing_accel(params, network, vehicle, motion, speed_reference, accel_reference, grade_accel, ahead, period):
    """Learn what the inverse model misses here and say what it will miss at the wanted point.

    Args:
        params: CruiseParams (learning and scales are used).
        network: EmranMemory with 3 inputs, changed in place.
        vehicle: VehicleParams the law believes in.
        motion: Motion, the measurements.
        speed_reference, accel_reference: wanted [m/s], [m/s2].
        grade_accel: g sin(grade) [m/s2] here; ahead: the same where the command will act.
        period: control period [s].

    Returns:
        (acceleration to add [m/s2], learning signal [m/s2], whether the sample was used)
    """
    emran = params.emran
    net, signal, learned = 0.0, 0.0, False
    if emran.authority > 0.0 and motion.speed > LEARNING_SPEED:
        here = _inputs(params, speed_reference, accel_reference, grade_accel)
        known = resistance(vehicle, speed_reference)
        missing = motion.achieved - (motion.specific_force - grade_accel) - known - grade_accel
        signal = missing - predict(emran, network, here)
        learned = learn(emran, network, here, signal, 1.0, period)
        if learned:
            learn_bias(emran, network, missing - predict(emran, network, here), 1.0, period)
        prune(emran, network, here)
    if emran.authority > 0.0:
        there = _inputs(params, speed_reference, accel_reference, ahead)
        net = emran.authority * predict(emran, network, there)
    return net, signal, learned


@njit
def _hold(speed_reference, speed, grade_accel, law, network, memory):
    """Brakes that hold the car, without the network, where standstill is wanted and reached."""
    if speed_reference < 0.05 and speed < HOLD_SPEED:
        held = -(HOLD_DECELERATION + abs(grade_accel))
        return min(law, held), 0.0, PidMemory(0.0, 0.0, memory.error)
    return law, network, memory


@njit
def _limited(params, accel):
    return min(max(accel, -params.decel_max), params.accel_max)
