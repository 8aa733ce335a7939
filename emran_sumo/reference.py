"""The speed that the cruise controller is to follow: SUMO's wish, as a calm driver would carry it out."""

import math

CURVE_BRAKING = 4.5  # m/s2: harder no bend is braked for, even where it shows late
SETTING_OFF, SETTING_OFF_ACCEL = 3.0, 0.5  # m/s, m/s2
LEAD_MOST = 0.5  # m/s
BEHIND_MOST = 0.5  # m/s
# m/s3 that the reference may have when it brakes and when it speeds up: SUMO's wish jumps with every new leader
HARDER, SOFTER = 20.0, 10.0
HARD_BRAKING = 3.5  # m/s2


class SpeedReference:
    """Where the reference is now, speed [m/s] and acceleration [m/s2].

    Args:
        speed: m/s, accel: m/s2, of the car when it is taken over.
        step: of SUMO [s].
        decel_most: that the controller may ask for [m/s2].
    """

    def __init__(self, speed: float, accel: float, step: float, decel_most: float) -> None:
        self.speed, self.accel = speed, accel
        self._step, self._decel_most = step, decel_most

    def toward(self, wish: float, present: float, top: float, bends: float) -> float:
        """By how much the reference changes in a step [m/s].

        Args:
            wish: SUMO's, for the end of the step; present: of the car [m/s].
            top: what road and car allow; bends: what the bends ahead allow [m/s].
        """
        before, step = self.speed, self._step
        # SUMO wishes from the present speed on: neither may a reference below it take hard braking for done, nor
        # may one above it take its own catching up for SUMO's wish
        change = wish - present
        most = before + (change if change < -HARD_BRAKING * step else max(change, 0.0))
        end = min(
            wish + self._lead(wish, present),
            most,
            max(bends, before - CURVE_BRAKING * step),
            before + self._eased(top - before),
        )
        end = max(end, before - self._decel_most * step)
        end = max(self._softened(end), present + change - BEHIND_MOST, 0.0)
        rise = end - before
        self.speed, self.accel = before + rise, rise / step
        return rise

    def _softened(self, end: float) -> float:
        """The wished speed at the end of the step [m/s] within the jerk of a calm driver; hard braking is at once."""
        before, accel, step = self.speed, max(self.accel, -HARD_BRAKING), self._step
        if end > before - HARD_BRAKING * step:
            end = max(end, before + (accel - HARDER * step) * step)
        return min(end, before + (accel + SOFTER * step) * step)

    def _eased(self, left: float) -> float:
        """Rise in a step [m/s] from which the reference comes to a speed `left` above it without a swing.

        With the acceleration a: a step + (a - SOFTER step) step + ... = left; SUMO speeds up to the last moment.
        """
        if left <= 0.0:
            return math.inf
        step = self._step
        return SOFTER * (math.sqrt(0.25 * step * step + 2.0 * left / SOFTER) - 0.5 * step) * step

    def _lead(self, wish: float, present: float) -> float:
        """How far the reference keeps ahead of a car that sets off [m/s].

        The wish is counted from the present speed: a reference that starts there anew each step would wait for the car.
        """
        if present > SETTING_OFF or wish < present + SETTING_OFF_ACCEL * self._step:
            return 0.0
        return min(max(self.speed - present, 0.0), LEAD_MOST)
