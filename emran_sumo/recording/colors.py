"""Colors of lines, scene and traffic."""

from collections.abc import Iterable

import numpy as np

# Mid luminance, so that lines stay legible in the dark and in the light theme of the viewer.
PINK, SLATE, TEAL, AMBER = (244, 63, 160), (120, 136, 160), (45, 190, 175), (245, 158, 11)
VIOLET, BLUE, RED, GREEN = (155, 120, 250), (14, 165, 233), (239, 80, 80), (34, 170, 100)
NIGHT, ASPHALT, PAINT = (15, 18, 24), (44, 49, 58), (226, 232, 240)
LABEL, COMPANION = (255, 255, 255), (230, 222, 255)  # behind words the light theme lays gray, the dark one black
GLASS, RUBBER = (120, 20, 75), (12, 14, 18)
BRAKE_ON, BRAKE_OFF = (255, 45, 35), (95, 12, 25)
SLIPPERY = (30, 70, 130)  # asphalt with less friction
SIGNAL_COLORS = {"G": (34, 197, 94), "g": (34, 197, 94), "y": (250, 204, 21), "Y": (250, 204, 21)}
SIGNAL_COLORS |= {"u": (249, 115, 22), "r": (239, 40, 40), "o": (148, 163, 184), "O": (148, 163, 184)}

SPEED_STOPS = np.array([0.0, 8.0, 16.0, 24.0, 32.0])  # m/s
SPEED_COLORS = np.array([(220, 50, 47), (245, 140, 40), (250, 215, 70), (95, 205, 130), (70, 150, 255)], dtype=float)
LEGEND = "traffic by speed: red 0, orange 8, yellow 16, green 24, blue 32 m/s"

# One per compared controller, in their order: Okabe and Ito's hues, which color-blind readers can tell apart
COMPARED = (
    (222, 143, 5), (64, 160, 230), (214, 92, 170), (2, 158, 115), (213, 94, 0), (130, 120, 235), (148, 163, 184),
)  # fmt: skip


def packed(colors: Iterable[tuple[int, int, int]]) -> np.ndarray:
    """Opaque 0xRRGGBBAA of (n, 3) colors in 0..255, the one form Rerun cannot misread."""
    rgb = np.asarray(list(colors), dtype=np.uint32).reshape(-1, 3)
    return (rgb[:, 0] << 24) | (rgb[:, 1] << 16) | (rgb[:, 2] << 8) | np.uint32(255)


def _speed_scale() -> np.ndarray:
    speeds = np.arange(0.0, SPEED_STOPS[-1] + 0.25, 0.5)
    return packed(np.column_stack([np.interp(speeds, SPEED_STOPS, c) for c in SPEED_COLORS.T]).astype(int))


_SPEED_SCALE = _speed_scale()


def speed_colors(speed: np.ndarray) -> np.ndarray:
    """(n,) packed colors of speeds [m/s], in steps of 0.5 m/s, so that steady traffic compresses well."""
    step = np.rint(2.0 * np.asarray(speed)).astype(np.int64)
    return _SPEED_SCALE[np.clip(step, 0, len(_SPEED_SCALE) - 1)]
