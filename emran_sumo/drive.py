"""One run: the host loop between a world and its egos, and what it leaves in the run's folder."""

import contextlib
import json
import math
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from emran_sumo.ego import COLUMNS, Ego
from emran_sumo.errors import UserError
from emran_sumo.faults import ControllerFault
from emran_sumo.loop import AT, DIVERGED, PATH_ENDED
from emran_sumo.manifest import clear, manifest, prepare, properties, writable, write_summary
from emran_sumo.opening import World, opening
from emran_sumo.recording.car import EgoShape
from emran_sumo.recording.insight import insights
from emran_sumo.recording.recorder import Recorder
from emran_sumo.recording.surroundings import patch_on
from emran_sumo.recording.watch import Limits
from emran_sumo.report import summary_markdown
from emran_sumo.results import Tally, summary_of, write_traces
from emran_sumo.scenario import Located, Scenario
from emran_sumo.stop import Stop, stoppable
from emran_sumo.takeover import Driven, Takeovers
from emran_sumo.user_code import maker as maker_of
from emran_sumo.warm import Progress, warm_kernels
from emran_sumo.world import waiting
from emran_sumo.world.native import Native, watch
from emran_sumo.world.persons import SHOWN, Persons, joined
from emran_sumo.world.records import NOBODY
from emran_sumo.world.signals import Signals, stop_lines
from emran_sumo.world.sumo import SumoWorld
from emran_sumo.world.track import TrackWorld
from emran_sumo.world.written import real_only

MIRROR_TOLERANCE = 1e-3  # m between the plant and its copy in SUMO
EGO_HEIGHT = 1.45  # m, for the picture
STANDS = 0.2  # m/s
OFF_ROUTE_MOST = 0.5  # s after which SUMO may find it beside its route
OFF_ROAD_MOST = 1.0  # s that the ego may be where SUMO finds no lane


class RunResult(NamedTuple):
    """Outcome of a run.

    folder: where its files lie; ended: "finished", "arrived", "collision", "diverged", "lost" or "interrupted"; reason:
    one sentence; metrics: by group; trace: (n, len(COLUMNS)); shape: its outline. All of the first ego; the others are
    in the summary.
    """

    folder: Path
    ended: str
    reason: str
    metrics: dict[str, dict[str, Any]]
    trace: np.ndarray
    shape: EgoShape

    @property
    def signals(self) -> np.ndarray:
        """The trace as a structured array (n,): signals["cross_track_error"], all names in signals.dtype.names."""
        return np.ascontiguousarray(self.trace).view([(name, float) for name in COLUMNS])[:, 0]

    @property
    def recording(self) -> Path:
        """The file for the viewer, where one was written."""
        return self.folder / "run.rrd"


class Outcome(NamedTuple):
    """How one ego ended, as in RunResult."""

    ended: str
    reason: str


def run(
    located: Located,
    out: Path | str = "runs",
    *,
    record: bool = True,
    gui: bool = False,
    live: str = "",
    command: str = "",
    progress: Progress = lambda *_: None,
) -> RunResult:
    """Drive one scenario to its end and write the run's folder.

    Args:
        located: scenario from `scenario.load`.
        out: folder that holds the runs; the run's own is <scenario>/<controller>-seed<k> in it.
        record: write run.rrd.
        gui: open SUMO's own window.
        live: address of a viewer that shows the recording while it is written.
        command: what the user typed, kept in the summary.
        progress: called with (phase, seconds done, seconds in all).

    Raises:
        UserError: a file, id or folder is not usable.
    """
    with stoppable() as stop:
        return _run(located, Path(out), stop, record, gui, live, command, progress)


def _run(
    located: Located, out: Path, stop: Stop, record: bool, gui: bool, live: str, command: str, progress: Progress
) -> RunResult:
    scenario = located.values
    open_world, maker = opening(located), maker_of(located)
    folder = prepare(out, located)  # only now: a mistake must not cost the older run
    warm_kernels(scenario, progress)
    with writable(folder), real_only(folder), open_world(folder, gui) as world:
        for done in world.warm_up(scenario.warm_up):
            progress("warm-up", done, scenario.warm_up)
        takeovers = Takeovers(world, located, maker)
        egos = takeovers.first(progress)
        told = manifest(located, command)
        first = next(iter(egos.values())).ego
        clear(folder)  # the older run stays until the new one has begun
        stop.driving = True
        signals = Signals() if record and isinstance(world, SumoWorld) else None
        recorder = _open_recorder(folder, located, first, world, told, live, signals) if record else None
        with recorder or contextlib.nullcontext():
            host = Host(world, scenario, egos, takeovers, recorder, stop, progress, signals)
            host.drive(real_time=gui)
            summary = summary_of(host, told)
            if recorder is not None:
                recorder.close(summary_markdown(summary), properties(located, summary["ended"]))
        write_traces(folder, host)
        write_summary(folder / "summary.json", summary)
    if host.fault is not None:
        host.fault.add_note(f"What was driven until then: {folder}")
        raise host.fault
    return RunResult(folder, summary["ended"], summary["reason"], summary["metrics"], first.trace(), _shape(first))


def native(located: Located, result: RunResult, progress: Progress = lambda *_: None) -> Native:
    """The same scenario and seed with SUMO driving the ego of a run, for comparison.

    Raises:
        UserError: SUMO stops.
    """
    scenario = located.values
    name = json.loads((result.folder / "summary.json").read_text(encoding="utf-8"))["ego"]
    with TemporaryDirectory() as folder, opening(located)(Path(folder), False) as world:
        assert isinstance(world, SumoWorld)
        for done in world.warm_up(scenario.warm_up):
            progress("native", done, scenario.warm_up)
        while name not in world.present():
            if world.expected() == 0 or world.time > world.end:
                raise UserError(f'--baseline-native: vehicle "{name}" did not depart where SUMO drives it.')
            world.advance()
        found = watch(world, name, min(scenario.duration, world.end - world.time))
    summary = json.loads((result.folder / "summary.json").read_text(encoding="utf-8"))
    write_summary(result.folder / "summary.json", summary | {"native": found._asdict()})
    return found


class Host:
    """The host loop: one round per SUMO step, for all egos."""

    def __init__(
        self,
        world: World,
        scenario: Scenario,
        egos: dict[str, Driven],
        takeovers: Takeovers,
        recorder: Recorder | None,
        stop: Stop,
        progress: Progress,
        signals: Signals | None = None,
    ) -> None:
        self.world, self.scenario, self.recorder, self._takeovers = world, scenario, recorder, takeovers
        self.all = dict(egos)
        self.active = dict(egos)
        self.shown = next(iter(egos))
        self.outcomes: dict[str, Outcome] = {}
        self.fault: ControllerFault | None = None  # of a user's own controller: ends the run
        self.tally = Tally(world)
        self.wall = 0.0
        self._off_road: dict[str, int] = {}  # steps in a row
        self._stop, self._progress, self._signals = stop, progress, signals
        self._persons = Persons() if isinstance(world, SumoWorld) else None

    def drive(self, real_time: bool = False) -> None:
        """Drive until every ego has ended, or the duration; no faster than the clock on the wall with `real_time`."""
        began = time.perf_counter()
        left = self.world.end - self.world.time if isinstance(self.world, SumoWorld) else math.inf
        duration = min(self.scenario.duration, left)
        steps = max(round(duration / self.world.step), 1)
        for done in range(1, steps + 1):
            try:
                self._step()
            except ControllerFault as error:  # of one that was to be taken over
                self._failed(error)
            except UserError as error:
                if not real_time:
                    raise
                self._stop.sumo_said = str(error)  # whoever watches has closed the window
            self._progress("drive", done * self.world.step, duration)
            if real_time:  # somebody watches SUMO's own window
                time.sleep(max(began + done * self.world.step - time.perf_counter(), 0.0))
            if self._stop.words or self._is_over():
                break
        for name, driven in self.active.items():
            reason = f"drove {driven.ego.time:g} s as planned"
            if duration < self.scenario.duration:
                reason = f"drove {driven.ego.time:g} s, to the configuration's own end"
            ended = Outcome("finished", reason)
            if self._stop.words:
                ended = Outcome("interrupted", f"{self._stop.words} after {driven.ego.time:.1f} s")
            self.outcomes[name] = ended
        self.wall = time.perf_counter() - began

    @property
    def never_seen(self) -> list[str]:
        """Egos that were asked for by their ids and have not come."""
        return [name for name in self._takeovers.selection.ids if name not in self.all]

    def _is_over(self) -> bool:
        if self.active:
            return False
        world = self.world
        if isinstance(world, TrackWorld):
            return True
        return self._takeovers.selection.complete(len(self.all)) or world.expected() == 0

    def _step(self) -> None:
        world, egos = self.world, {name: driven.ego for name, driven in self.active.items()}
        intents = world.propose({name: ego.pose for name, ego in egos.items()})  # what SUMO itself would do now
        rows = {}
        for name, ego in egos.items():
            ego.follow(intents[name])
            rows[name] = ego.advance()  # 1 kHz plant, 100 Hz control: one kernel call
        world.commit({name: ego.pose for name, ego in egos.items()})
        for name, ego in egos.items():
            self._observe(ego, rows[name], intents[name])
        self.tally.look(world, self.all, tuple(self.active))
        new = self._takeovers.newcomers(len(self.all))
        self.all |= new
        self.active |= new

    def _failed(self, fault: ControllerFault) -> None:
        """The first fault ends the run for all egos, after this step."""
        self.fault = self.fault or fault
        self._stop.failed = True

    def _observe(self, ego: Ego, rows: np.ndarray, intent) -> None:
        world, name = self.world, ego.name
        error = world.mirror_error(name, ego.pose)
        lane = world.lane_of(name)
        self._off_road[name] = 0 if lane else self._off_road.get(name, 0) + 1
        if isinstance(world, SumoWorld) and self._off_road[name] * world.step > OFF_ROUTE_MOST and world.knows(name):
            world.search(name)
        if lane:
            self.tally.mirror[name] = max(self.tally.mirror.get(name, 0.0), error)
        traffic = world.neighbors(name) if lane else NOBODY
        before = ego.frames.last[-1] if len(ego.frames.last) else None
        is_drawn = self.recorder is not None and name == self.shown
        reach = SHOWN if is_drawn else ego.vehicle.length + ego.vehicle.width
        persons = self._persons.around(ego.pose.x, ego.pose.y, reach) if self._persons else NOBODY
        others = ego.observe(traffic, error if lane else math.nan, rows, persons)
        outcome = self._outcome(ego, error, lane)
        if outcome is None and lane:
            if isinstance(world, SumoWorld) and world.rerouted(name):
                self.active[name].planner.reroute(ego, world)
            self.active[name].planner.plan(ego, intent, others, world)
        if self.recorder is not None and is_drawn:
            self.recorder.write(ego.frames.last, joined(traffic, persons), ego.reference_ahead, self.active)
            _tell(self.recorder, ego, before, self._signals, isinstance(world, SumoWorld))
        if outcome is not None:
            self.outcomes[name] = outcome
            del self.active[name]
            world.release(name)

    def _outcome(self, ego: Ego, mirror_error: float, lane: str) -> Outcome | None:
        """Why an ego ends after this step, or None."""
        car, after = ego.state.vehicle, f"after {ego.time:.1f} s"
        if ego.own is not None and ego.own.fault is not None:
            self._failed(ego.own.fault)
            return Outcome("fault", str(ego.own.fault).rstrip("."))
        if ego.status == DIVERGED:
            row = ego.frames.last[-1]
            return Outcome(
                "diverged",
                f"the controller lost the car {after}: cross-track error {row[AT.cross_track_error]:.2f} m, "
                f"heading error {math.degrees(row[AT.heading_error]):.0f} deg{ego.too_tight()}",
            )
        where = f"{after} at ({car.x:.1f}, {car.y:.1f}) m"
        if ego.collided:
            return Outcome("collision", f"collided {where} with {'; '.join(ego.collided.values())}")
        if isinstance(self.world, SumoWorld) and not self.world.knows(ego.name):
            return Outcome("lost", f"SUMO removed the ego {where}")
        if not lane and self._off_road[ego.name] * self.world.step > OFF_ROAD_MOST:
            return Outcome("lost", f"SUMO lost the ego {where}: it is off the road")
        if not lane:
            return None
        if self.world.arrived(ego.name):
            return Outcome("arrived", f"reached the end of its route {after}")
        if ego.status == PATH_ENDED or ego.path_ended:
            return self._path_ended(ego, where)
        if mirror_error > MIRROR_TOLERANCE:
            return Outcome("lost", f"SUMO lost the ego {where}: its copy is {mirror_error:.3f} m away")
        return None

    def _path_ended(self, ego: Ego, where: str) -> Outcome:
        """The path is used up: on the last edge that is the arrival, elsewhere the lane leads nowhere."""
        world = self.world
        if isinstance(world, TrackWorld) or world.on_last_edge(ego.name):
            return Outcome("arrived", f"reached the end of its route after {ego.time:.1f} s")
        return Outcome("lost", f"its lane ended before its route did {where}")


def _tell(recorder: Recorder, ego: Ego, before: np.ndarray | None, signals: Signals | None, in_traffic: bool) -> None:
    control, row = ego.control, ego.frames.last[-1]
    if before is None:
        first = ego.frames.last[0]
        recorder.event(first[AT.time], "INFO", f"{ego.name} taken over at {first[AT.speed_long]:.1f} m/s")
    stands = waiting.reason(ego.name) if ego.maneuver == "keep lane" and ego.speed < STANDS and in_traffic else ""
    if recorder.state(ego.time, "maneuver", stands or ego.maneuver) and stands:
        recorder.event(ego.time, "INFO", f"stands: {stands}")
    recorder.state(ego.time, "learning", ego.learning(ego.frames.last, before))
    for event in ego.events[ego.told :]:
        recorder.event(*event)
    ego.told = len(ego.events)
    if ego.base is not recorder.patched:  # its first lane, or another one
        recorder.patched = ego.base
        recorder.patch(ego.time, patch_on(ego.scenario.disturbance, ego.base, ego.lane_width, ego.offset))
    for name, seen in insights(control, ego.networks, row):
        recorder.network(ego.time, name, seen)
    lights = signals.changed() if signals is not None else None
    if lights is not None:
        recorder.signals(ego.time, lights)


def _open_recorder(
    folder: Path,
    located: Located,
    ego: Ego,
    world: World,
    told: dict[str, Any],
    live: str,
    signals: Signals | None,
) -> Recorder:
    s, v = located.values, ego.vehicle
    name = f"{located.name}, {s.controller}, seed {s.seed}"
    identity = f"{located.name}-{s.controller}-seed{s.seed}-{told['digest']}"
    file = folder / "run.rrd"
    road = world.road()
    if isinstance(world, SumoWorld) and signals is not None:
        road = road._replace(stop_lines=stop_lines(world.map, signals))
    limits = Limits(v.steer_limit, v.steer_rate, s.longitudinal.accel_max, s.longitudinal.decel_max)
    try:
        return Recorder(
            file, recording=identity, name=name, road=road, ego=_shape(ego), columns=COLUMNS,
            limits=limits, live=live,
        )  # fmt: skip
    except RuntimeError as error:
        raise UserError(f"--out: cannot write {file}: {error}; accepted is a writable folder with room.") from None


def _shape(ego: Ego) -> EgoShape:
    v = ego.vehicle
    return EgoShape(v.length, v.width, EGO_HEIGHT, v.front_axle + v.rear_axle, v.front_axle, v.front_overhang)
