"""One run: the host loop between SUMO and the ego, and what it leaves in the run's folder."""

import contextlib
import gzip
import hashlib
import json
import math
import platform
import shlex
import signal
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import numpy as np

from emran_sumo import __version__, kernels, locate, metrics
from emran_sumo.ego import COLUMNS, UNITS, Ego, learning_state
from emran_sumo.errors import UserError, nearest_name
from emran_sumo.loop import AT, DIVERGED, PATH_ENDED, blank_networks, closed_loop, new_trace, quiet_references, start
from emran_sumo.path import Path as Track
from emran_sumo.path import project
from emran_sumo.plant.vehicle import rolling_start
from emran_sumo.recording.car import EgoShape
from emran_sumo.recording.recorder import Recorder
from emran_sumo.recording.table import write_trace
from emran_sumo.report import summary_markdown
from emran_sumo.scenario import Located, Scenario, to_dict
from emran_sumo.world.demand import write_demand
from emran_sumo.world.flow import PERIOD, Flow
from emran_sumo.world.network import main_limit
from emran_sumo.world.routes import check_ego, departures
from emran_sumo.world.sumo import SumoWorld
from emran_sumo.world.sumo import version as sumo_version
from emran_sumo.world.track import TrackWorld

MIRROR_TOLERANCE = 1e-3  # m between the plant and its copy in SUMO
EGO_HEIGHT = 1.45  # m, for the picture

Progress = Callable[[str, float, float], None]  # phase, seconds done, seconds in all


class RunResult(NamedTuple):
    """Outcome of a run.

    folder: where its files lie; ended: "finished", "arrived", "collision", "diverged", "lost" or "interrupted"; reason:
    one sentence; metrics: by group; trace: (n, len(COLUMNS)).
    """

    folder: Path
    ended: str
    reason: str
    metrics: dict[str, dict[str, Any]]
    trace: np.ndarray


class Stop:
    """Ctrl-C and SIGTERM end the run at the next step, so that everything is written; a second Ctrl-C breaks off."""

    def __init__(self) -> None:
        self.signal = 0

    def __call__(self, number: int, _frame: FrameType | None) -> None:
        if self.signal:
            raise KeyboardInterrupt
        self.signal = number


@contextlib.contextmanager
def _stoppable() -> Iterator[Stop]:
    stop, saved = Stop(), {}
    for number in (signal.SIGINT, signal.SIGTERM):
        with contextlib.suppress(ValueError):  # only the main thread may
            saved[number] = signal.signal(number, stop)
    try:
        yield stop
    finally:
        for number, handler in saved.items():
            signal.signal(number, handler)


def run(
    located: Located,
    out: Path | str = "runs",
    *,
    record: bool = True,
    gui: bool = False,
    command: str = "",
    progress: Progress = lambda *_: None,
) -> RunResult:
    """Drive one scenario to its end and write the run's folder.

    Args:
        located: scenario from `scenario.load`.
        out: folder that holds the runs; the run's own is <scenario>/<controller>-seed<k> in it.
        record: write run.rrd.
        gui: open SUMO's own window.
        command: what the user typed, kept in the summary.
        progress: called with (phase, seconds done, seconds in all).

    Raises:
        UserError: a file, id or folder is not usable.
    """
    scenario = located.values
    on_track = scenario.world == "track"
    network, routes = (Path(), []) if on_track else _files(located)
    if not on_track:
        check_ego(scenario.ego, routes)
    folder = _prepare(Path(out), located)  # only now: a mistake must not cost the older run
    warm_kernels(scenario, progress)
    world = _open_track(scenario) if on_track else _open_sumo(scenario, folder, network, routes, gui)
    v = scenario.vehicle
    with world, _stoppable() as stop:
        for now in world.warm_up(scenario.warm_up):
            progress("warm-up", now, scenario.warm_up)
            if stop.signal:
                raise KeyboardInterrupt
        if isinstance(world, SumoWorld):
            world.wait_for(scenario.ego, routes)
        ego = Ego(scenario.ego, scenario, world.take_over(scenario.ego, v.width))
        manifest = _manifest(located, command)
        recorder = _open_recorder(folder, located, world, manifest) if record else None
        with recorder or contextlib.nullcontext():
            began = time.perf_counter()
            ended, reason, seen = _drive(world, ego, recorder, stop, progress)
            wall = time.perf_counter() - began
            trace = ego.trace()
            found = _measure(ego, trace, wall, seen, world.step)
            found_and = {"ended": ended, "reason": reason, "metrics": found, "manifest": manifest}
            if recorder is not None:
                recorder.close(summary_markdown(found_and), _properties(located, ended))
    write_trace(folder / "trace.parquet", COLUMNS, trace, UNITS)
    _write_summary(folder / "summary.json", found_and)
    return RunResult(folder, ended, reason, found, trace)


def _open_track(scenario: Scenario) -> TrackWorld:
    rates = scenario.rates
    return TrackWorld(
        scenario.track, scenario.duration, rates.sumo_step, rates.control_step, scenario.longitudinal.preview
    )


def _open_sumo(scenario: Scenario, folder: Path, network: Path, routes: list[Path], gui: bool) -> SumoWorld:
    traffic_file = folder / "traffic.rou.xml"
    _write_traffic(traffic_file, network, routes, scenario)
    v, rates = scenario.vehicle, scenario.rates
    front = v.front_axle + v.front_overhang
    files = [*routes, traffic_file]
    limit = scenario.road.speed_limit
    return SumoWorld(network, files, rates.sumo_step, scenario.seed, front, limit, rates.driver_step, gui)


class Seen(NamedTuple):
    """What the host loop counts: largest mirror error [m], crashes among others, mean number of vehicles, traffic."""

    mirror_error: float
    others_collided: int
    vehicles: float
    traffic: dict[str, float]


def _drive(
    world: SumoWorld | TrackWorld, ego: Ego, recorder: Recorder | None, stop: Stop, progress: Progress
) -> tuple[str, str, Seen]:
    """The host loop: one round per SUMO step."""
    scenario = ego.scenario
    name = ego.name
    steps = max(round(scenario.duration / world.step), 1)
    worst, crashes, vehicles = 0.0, set(), 0
    flow, period = Flow() if isinstance(world, SumoWorld) else None, max(round(PERIOD / world.step), 1)
    ended, reason, done = "finished", f"drove {scenario.duration:g} s as planned", 0
    before = None
    for done in range(1, steps + 1):
        intents = world.propose({name: ego.pose})  # what SUMO itself would do now
        ego.follow(intents[name])
        rows = ego.advance()  # 1 kHz plant, 100 Hz control: one kernel call
        world.commit({name: ego.pose})
        error = world.mirror_error(name, ego.pose)
        worst, vehicles = max(worst, error), vehicles + world.vehicle_count()
        traffic = world.neighbors(name)
        side = ego.wanted_side
        rows = ego.observe(traffic, error, rows)
        if ego.wanted_side != side:
            world.ask_for_room(name, ego.wanted_side)
        crashes |= {tuple(sorted(pair)) for pair in world.collisions() if name not in pair}
        if flow is not None and (done - 1) % period == 0:
            flow.look()
        if recorder is not None:
            recorder.write(rows, traffic, ego.reference_ahead())
            _tell(recorder, ego, rows, before)
        before = rows[-1]
        progress("drive", done * world.step, scenario.duration)
        outcome = _outcome(ego, error, world.lane_of(name), stop)
        if outcome is not None:
            ended, reason = outcome
            break
    return ended, reason, Seen(worst, len(crashes), vehicles / max(done, 1), flow.means() if flow else {})


def _tell(recorder: Recorder, ego: Ego, rows: np.ndarray, before: np.ndarray | None) -> None:
    control = ego.scenario.control
    aided = control.longitudinal.emran.authority > 0.0 or control.lateral.emran.authority > 0.0
    recorder.state(ego.time, "maneuver", ego.maneuver)
    recorder.state(ego.time, "learning", learning_state(rows, before, aided))
    for event in ego.events[ego.told :]:
        recorder.event(*event)
    ego.told = len(ego.events)


def _outcome(ego: Ego, mirror_error: float, lane: str, stop: Stop) -> tuple[str, str] | None:
    """Why the run ends after this step, or None."""
    car = ego.state.vehicle
    if ego.status == DIVERGED:
        row = ego.frames[-1][-1]
        return "diverged", (
            f"the controller lost the car after {ego.time:.1f} s: cross-track error {row[AT.cross_track_error]:.2f} m, "
            f"heading error {math.degrees(row[AT.heading_error]):.0f} deg"
        )
    if ego.collided:
        return "collision", f"collided with {', '.join(sorted(ego.collided))} after {ego.time:.1f} s"
    if ego.status == PATH_ENDED or ego.arrived:
        return "arrived", f"reached the end of its route after {ego.time:.1f} s"
    if not lane or mirror_error > MIRROR_TOLERANCE:
        return "lost", (
            f"SUMO lost the ego after {ego.time:.1f} s at ({car.x:.1f}, {car.y:.1f}) m: "
            + ("it is off the road" if not lane else f"its copy is {mirror_error:.3f} m away")
        )
    if stop.signal:
        return "interrupted", f"stopped by {signal.Signals(stop.signal).name} after {ego.time:.1f} s"
    return None


def _measure(ego: Ego, trace: np.ndarray, wall: float, seen: Seen, step: float) -> dict[str, dict[str, Any]]:
    columns = {name: trace[:, i] for i, name in enumerate(COLUMNS)}
    moving = trace[-1:, AT.time].sum()

    def least(name: str) -> float | None:
        values = columns[name]
        low = values.min(initial=math.inf)
        return float(low) if math.isfinite(low) else None

    return {
        "tracking": metrics.tracking(trace),
        "safety": {
            "time_to_collision_min": least("time_to_collision"),
            "gap_min": least("lead_gap"),
            "deceleration_to_avoid_max": metrics.largest(columns["deceleration_to_avoid"]),
            "collisions": len(ego.collided),
            "collisions_of_others": seen.others_collided,
        },
        "comfort": metrics.comfort(trace),
        "effort": metrics.effort(trace),
        "networks": metrics.networks(trace),
        "traffic": seen.traffic,
        "run": {
            "simulated": float(moving),
            "distance": float(np.hypot(np.diff(columns["x"]), np.diff(columns["y"])).sum()),
            "real_time_factor": float(moving / wall) if wall > 0.0 else None,
            "vehicles_mean": seen.vehicles,
            "mirror_error_max": seen.mirror_error,
            "double_lane_change_began": ego.began,
        },
    }


def _prepare(out: Path, located: Located) -> Path:
    """The run's folder, emptied of an older run of the same name."""
    s = located.values
    folder = out / located.name / f"{s.controller}-seed{s.seed}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in ("run.rrd", "trace.parquet", "summary.json", "traffic.rou.xml"):
            (folder / name).unlink(missing_ok=True)
        (folder / "traffic.rou.xml").touch()
    except OSError as error:
        raise UserError(f"--out: cannot write to {folder}: {error.strerror}; accepted is a writable folder.") from None
    return folder


def _files(located: Located) -> tuple[Path, list[Path]]:
    """Network and route files: beside the scenario, or a shipped network by its name."""
    s = located.values
    network = located.folder / s.network
    if not network.suffix and not network.is_file():
        network = locate.folder("networks") / s.network / f"{s.network}.net.xml"
    if not network.is_file():
        hint = nearest_name(s.network, [folder.name for folder in locate.folder("networks").iterdir()])
        raise UserError(f'network: found "{s.network}"; no such network file: {network}. {hint}')
    return network, [located.folder / name for name in s.routes]


def _write_traffic(file: Path, network: Path, routes: list[Path], scenario: Scenario) -> None:
    try:
        limit = scenario.road.speed_limit or main_limit(network)
        egos = departures(routes, [scenario.ego], limit)
        write_demand(file, network, routes, scenario.traffic, limit, scenario.seed, egos)
    except (ET.ParseError, gzip.BadGzipFile, EOFError) as error:
        raise UserError(f"{network}: not a network file: {error}.") from None
    except ValueError as error:
        raise UserError(f"traffic: {error}.") from None


def warm_kernels(scenario: Scenario, progress: Progress = lambda *_: None) -> None:
    """Compile or load every kernel of a run by driving a tenth of a second on a straight line."""
    if not kernels.compiled_before():
        progress("compile", 0.0, 0.0)
    n = 400
    line = np.arange(n) * 0.25
    flat = np.zeros(n)
    track = Track(line, flat, flat, flat, flat, 0.25)
    state = start(scenario.vehicle, rolling_start(scenario.vehicle, 10.0, 5.0, 0.0, 0.0), 5.0, True)
    nets = blank_networks(scenario.control)
    references = quiet_references(track, np.full(3, 10.0), np.zeros(2))
    closed_loop(
        scenario.vehicle, scenario.control, scenario.disturbance, scenario.road.friction, scenario.clock(),
        references, state, nets.speed, nets.steering, new_trace(2),
    )  # fmt: skip
    project(track, np.ones(1), np.ones(1), 5.0, 10.0)
    kernels.mark_compiled()


def _open_recorder(folder: Path, located: Located, world: SumoWorld | TrackWorld, manifest: dict[str, Any]) -> Recorder:
    s, v = located.values, located.values.vehicle
    shape = EgoShape(v.length, v.width, EGO_HEIGHT, v.front_axle + v.rear_axle, v.front_axle, v.front_overhang)
    name = f"{located.name}, {s.controller}, seed {s.seed}"
    identity = f"{located.name}-{s.controller}-seed{s.seed}-{manifest['digest']}"
    road = world.road()
    file = folder / "run.rrd"
    return Recorder(file, recording=identity, name=name, road=road, ego=shape, columns=COLUMNS)


def _manifest(located: Located, command: str) -> dict[str, Any]:
    """What is needed to repeat the run and to read it a month later."""
    resolved = to_dict(located.values)
    digest = hashlib.sha256(json.dumps(resolved, sort_keys=True).encode()).hexdigest()[:12]
    packages = {name: version(name) for name in ("numpy", "numba", "scipy", "pyarrow")}
    return {
        "scenario_name": located.name,
        "command": command or shlex.join(["emran-sumo", "run", located.name]),
        "digest": digest,
        "seeds": {"traffic": located.values.seed, "sumo": located.values.seed},
        "versions": {
            "emran_sumo": __version__,
            "sumo": sumo_version(),
            **packages,
            "rerun": version("rerun-sdk"),
            "python": platform.python_version(),
        },
        "created": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "scenario": resolved,
    }


def _properties(located: Located, ended: str) -> dict[str, Any]:
    s = located.values
    return {
        "scenario": located.name,
        "controller": s.controller,
        "seed": s.seed,
        "ended": ended,
        "version": __version__,
    }


def _write_summary(file: Path, content: dict[str, Any]) -> None:
    part = file.with_suffix(".part")
    part.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    part.replace(file)
