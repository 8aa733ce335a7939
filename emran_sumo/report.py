"""A run in words: the same rows for the terminal and for the recording."""

import math
import re
from collections import Counter
from typing import Any, NamedTuple

UNHARMED = ("finished", "arrived", "interrupted")
FOLDER = re.compile(r" --out[ =]('[^']*'|\S+)")  # in a command: where the files go makes no other run


class Row(NamedTuple):
    """One line of the table: group, what it is, RMS or single value, largest value."""

    group: str
    name: str
    value: str
    most: str = ""


def rows(summary: dict[str, Any]) -> list[Row]:
    """The table of a run from its summary."""
    m = summary["metrics"]
    tracking, comfort, safety, nets, run = (m[k] for k in ("tracking", "comfort", "safety", "networks", "run"))
    degrees = 180.0 / math.pi
    return [
        _pair("tracking", "cross-track error", tracking, "cross_track_error", "m", 4),
        _pair("tracking", "heading error", tracking, "heading_error", "deg", 3, degrees),
        _pair("tracking", "speed error", tracking, "speed_error", "m/s", 4),
        Row("safety", "least time to collision", _number(safety["time_to_collision_min"], "s", 1)),
        Row("safety", "least time headway", _number(safety["time_headway_min"], "s", 1)),
        Row("safety", "least post-encroachment time", _number(safety["post_encroachment_time_min"], "s", 1)),
        Row("safety", "conflicts (TTC < 3 s, DRAC > 3 m/s²)", str(safety["conflicts"])),
        Row("safety", "least gap ahead", _number(safety["gap_min"], "m", 1)),
        Row("safety", "collisions of the ego", str(safety["collisions"])),
        Row("safety", "collisions of others", str(safety["collisions_of_others"])),
        _pair("comfort", "lateral acceleration", comfort, "accel_lat", "m/s²", 2),
        _pair("comfort", "lateral jerk", comfort, "jerk_lat", "m/s³", 2),
        _pair("comfort", "longitudinal acceleration", comfort, "accel_long", "m/s²", 2),
        _pair("comfort", "longitudinal jerk", comfort, "jerk_long", "m/s³", 2),
        _neurons("steering", nets),
        _neurons("speed", nets),
        Row("run", "simulated", _number(run["simulated"], "s", 1)),
        Row("run", "real-time factor", _number(run["real_time_factor"], "", 1)),
        Row("run", "vehicles on the road, mean", _number(run["vehicles_mean"], "", 0)),
    ]


def _pair(group: str, name: str, values: dict[str, float], key: str, unit: str, digits: int, scale=1.0) -> Row:
    both = (_number(values[f"{key}_{kind}"] * scale, unit, digits) for kind in ("rms", "max"))
    return Row(group, name, *both)


def _neurons(name: str, nets: dict[str, Any]) -> Row:
    share = f"{100.0 * nets[f'learned_share_{name}']:.0f} % of samples learned"
    end, most = nets[f"neurons_{name}_end"], nets[f"neurons_{name}_max"]
    return Row("networks", f"{name} network", f"{_count(end)} at the end, {share}", _count(most))


def _count(neurons: int) -> str:
    return f"{neurons} neuron" if neurons == 1 else f"{neurons} neurons"


def _number(value: float | None, unit: str, digits: int) -> str:
    return "none" if value is None else f"{value:.{digits}f} {unit}".strip()


def verdict(summary: dict[str, Any]) -> str:
    """One sentence: what was driven and how it ended."""
    s = summary["manifest"]["scenario"]
    name = summary["manifest"]["scenario_name"]
    where = surroundings(s["world"], s["traffic"]["density"])
    of = f", ego {summary['ego']} of {len(summary['egos'])}" if "egos" in summary else ""
    return f"{name}, {s['controller']}, seed {s['seed']}, {where}{of}: {summary['ended']}, {summary['reason']}."


def ends(summary: dict[str, Any]) -> tuple[str, list[str]]:
    """How several egos ended: in numbers, and a sentence for each that came to harm; empty for a single one."""
    egos = summary.get("egos", {})
    counts = Counter(ego["ended"] for ego in egos.values())
    numbers = ", ".join(f"{count} {ended}" for ended, count in counts.most_common())
    harmed = [f"{name}: {ego['reason']}" for name, ego in egos.items() if ego["ended"] not in UNHARMED]
    return f"{len(egos)} egos: {numbers}" if egos else "", harmed


def surroundings(world: str, density: float) -> str:
    """The traffic in a few words; without a density it is that of the scenario's files."""
    if world == "track":
        return "open road"
    return f"{density:g} vehicles/km/lane" if density > 0.0 else "traffic of its files"


def summary_markdown(summary: dict[str, Any]) -> str:
    """The summary shown inside the recording."""
    m = summary["metrics"]
    t, s, n = m["tracking"], m["safety"], m["networks"]
    ttc = _number(s["time_to_collision_min"], "s", 1)
    neurons = f"{n['neurons_steering_max']} + {n['neurons_speed_max']}"
    cells = (
        ("cross-track RMS", f"**{t['cross_track_error_rms']:.3f} m**"),
        ("max", f"{t['cross_track_error_max']:.3f} m"),
        ("heading RMS", f"{math.degrees(t['heading_error_rms']):.2f}°"),
        ("speed RMS", f"{t['speed_error_rms']:.3f} m/s"),
        ("min TTC", ttc),
        ("collisions", str(s["collisions"])),
        ("neurons", neurons),
    )
    head = " | ".join(name for name, _ in cells)
    line = " | ".join("---" for _ in cells)
    body = " | ".join(value for _, value in cells)
    title = summary["manifest"]["scenario"]["title"]
    parts = [
        f"**{title}.** {verdict(summary)}" if title else f"**{verdict(summary)}**",
        f"| {head} |\n| {line} |\n| {body} |",
        *_told_ends(summary),
        f"Repeat: `{FOLDER.sub('', summary['manifest']['command'])}`",
        _all_metrics(summary),
        _origin(summary["manifest"]),
    ]
    return "\n\n".join(parts)


def _told_ends(summary: dict[str, Any]) -> list[str]:
    numbers, harmed = ends(summary)
    return [f"{numbers}{'. ' if harmed else ''}{'; '.join(harmed)}"] if numbers else []


def _all_metrics(summary: dict[str, Any]) -> str:
    """Every row of the table, by group, but how long it took: equal runs have equal recordings."""
    told = [row for row in rows(summary) if row.name != "real-time factor"]
    lines = [f"| {row.group} | {row.name} | {row.value} | {row.most} |" for row in told]
    return "\n".join(("| group | metric | RMS or value | largest |", "| --- | --- | --- | --- |", *lines))


def _origin(manifest: dict[str, Any]) -> str:
    """What the run was made of: scenario, seeds and versions."""
    s = manifest["scenario"]
    place = "analytic road" if s["world"] == "track" else s["config"] or s["network"]
    told = [
        ("title", s["title"]),
        ("road", place),
        ("controller", s["controller"]),
        ("settings", f"digest {manifest['digest']}"),
        ("seeds", ", ".join(f"{name} {seed}" for name, seed in manifest["seeds"].items())),
        ("versions", ", ".join(f"{name} {number}" for name, number in manifest["versions"].items())),
    ]
    lines = [f"| {name} | {value} |" for name, value in told if value]
    return "\n".join(("| scenario | " + manifest["scenario_name"] + " |", "| --- | --- |", *lines))
