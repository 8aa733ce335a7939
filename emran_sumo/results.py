"""What is counted while egos are driven, and what a run says of them afterwards."""

import hashlib
import math
from pathlib import Path
from typing import Any

import numpy as np

from emran_sumo import metrics
from emran_sumo.ego import COLUMNS, UNITS
from emran_sumo.loop import AT
from emran_sumo.opening import World
from emran_sumo.plant.vehicle import VehicleParams
from emran_sumo.recording.table import write_trace
from emran_sumo.world.flow import PERIOD, Flow
from emran_sumo.world.sumo import SumoWorld
from emran_sumo.world.wake import Wake


class Tally:
    """What the host loop counts over all egos."""

    def __init__(self, world: World) -> None:
        self.steps = 0
        self.vehicles = 0
        self.crashes: set[tuple[str, str]] = set()
        self.mirror: dict[str, float] = {}
        self.wakes: dict[str, Wake] = {}
        self.flow = Flow() if isinstance(world, SumoWorld) else None
        self._period = max(round(PERIOD / world.step), 1)

    def look(self, world: World, egos: dict[str, Any], active: tuple[str, ...]) -> None:
        """Count after a step; `active` egos are still on the road."""
        self.vehicles += world.vehicle_count()
        for pair in world.collisions():
            if not any(name in egos for name in pair):
                self.crashes.add((min(pair), max(pair)))
        if self.flow is not None:
            for name in active:
                self.wakes.setdefault(name, Wake(name)).look()
        if self.flow is not None and self.steps % self._period == 0:
            self.flow.look()
        self.steps += 1


def summary_of(host: Any, told: dict[str, Any]) -> dict[str, Any]:
    """Everything of a run but its traces; the shown ego first, all of several egos below it."""
    shown = host.outcomes[host.shown]
    found = {name: _measure(host, driven) for name, driven in host.all.items()}
    summary: dict[str, Any] = {"ended": shown.ended, "reason": shown.reason, "metrics": found[host.shown]}
    if len(host.all) > 1:
        summary["egos"] = {name: {**host.outcomes[name]._asdict(), "metrics": found[name]} for name in host.all}
    notes = list(host.world.notes) if isinstance(host.world, SumoWorld) else []
    if host.never_seen:
        notes.append(f"has not departed: {', '.join(host.never_seen)}")
    outline = _outline(host.all[host.shown].ego.vehicle)
    return summary | {"ego": host.shown, "outline": outline, "notes": notes, "manifest": told}


def _outline(v: VehicleParams) -> dict[str, float]:
    """Length and width of the body and how far its center is ahead of the center of gravity [m]."""
    return {"length": v.length, "width": v.width, "ahead": v.front_axle + v.front_overhang - 0.5 * v.length}


def _measure(host: Any, driven: Any) -> dict[str, dict[str, Any]]:
    ego, tally = driven.ego, host.tally
    trace = ego.trace()
    columns = {name: trace[:, i] for i, name in enumerate(COLUMNS)}
    moving = trace[-1:, AT.time].sum()

    lead = (columns[name] for name in ("lead_gap", "time_to_collision", "deceleration_to_avoid"))
    encounter = ego.encounters.least
    return {
        "tracking": metrics.tracking(trace),
        "safety": {
            **metrics.safety(trace, *lead),
            "post_encroachment_time_min": encounter if math.isfinite(encounter) else None,
            "collisions": len(ego.collided),
            "collisions_of_others": len(tally.crashes),
        },
        "comfort": metrics.comfort(trace),
        "effort": metrics.effort(trace),
        "networks": metrics.networks(trace),
        "traffic": tally.flow.means() if tally.flow else {},
        "wake": tally.wakes[ego.name].results() if ego.name in tally.wakes else {},
        "run": {
            "simulated": float(moving),
            "distance": float(np.hypot(np.diff(columns["x"]), np.diff(columns["y"])).sum()),
            "real_time_factor": float(tally.steps * host.world.step / host.wall) if host.wall > 0.0 else None,
            "vehicles_mean": tally.vehicles / max(tally.steps, 1),
            "mirror_error_max": tally.mirror.get(ego.name, 0.0),
            "double_lane_change_began": driven.planner.began,
            "lane_changes": getattr(driven.planner, "count", 0),
        },
    }


def write_traces(folder: Path, host: Any) -> None:
    """trace.parquet of the shown ego; egos/<id>.parquet of the others."""
    for name, driven in host.all.items():
        file = folder / "trace.parquet" if name == host.shown else folder / "egos" / f"{_file_name(name)}.parquet"
        write_trace(file, COLUMNS, driven.ego.trace(), UNITS)


def _file_name(ego: str) -> str:
    """An id of SUMO as the name of a file, another one for another id."""
    plain = "".join(c if c.isalnum() or c in "-_." else "_" for c in ego)
    return plain if plain == ego else f"{plain}-{hashlib.sha256(ego.encode()).hexdigest()[:6]}"
