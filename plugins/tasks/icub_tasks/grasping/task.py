"""The plugin `grasp`: a batch of worlds in which a hand in front of an object grasps and lifts it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded

from icub_core.bounds import above, at_least
from icub_core.data import Grasp
from icub_core.errors import CheckpointError, ConfigError, unknown_name
from icub_core.interfaces.feature_extractor import FeatureExtractor
from icub_core.interfaces.grasp_generator import GraspGenerator
from icub_core.interfaces.object_set import ObjectSet
from icub_core.interfaces.robot import Robot
from icub_core.interfaces.simulator import Simulator
from icub_core.interfaces.task import Start, Task
from icub_core.scene import CameraView, ObjectSpec, Scene
from icub_tasks.grasping.batch import TaskBatch, part
from icub_tasks.grasping.plan import GraspPlan, MaskProvider
from icub_tasks.grasping.pool import StartPool
from icub_tasks.grasping.signals import Signals
from icub_tasks.grasping.spaces import FINGERS, OBJECT_CENTER, VISUAL
from icub_tasks.grasping.termination import EndReason
from icub_tasks.grasping.visual import ImageEncoder, VisualStack
from icub_tasks.grasping.world import GraspWorld, StartState, TaskSettings

log = logging.getLogger(__name__)

FLAGS = ("success", "fault", "done", "terminated", "truncated")
"""Entries (N, 1) bool that a step gives."""
OBJECT_POSITION = "object_position"
"""Privileged entry: where the object really is, world, meters."""
OBJECT_HEIGHT = 0.1
"""Usual height of an object, meters."""
PLACEMENTS, MIN_PLANS = 8, 3
"""Placements that are planned, and plans that must come of them, before a world is given to an object."""


class GraspingTask(Task):
    """Grasp one object on a table and lift it by 10 cm (thesis 12.3.1), in N simulated worlds.

    Observation, float32: `hand_pose` (N, 6) world position and yaw, pitch, roll; `fingers` (N, F) rad; `touch` (N, T);
    `object_center` (N, 3) estimate at the start, world; what was planned: `plan_start` and `plan_grasp` (N, 3) world
    positions of the hand, `plan_opened` and `plan_closed` (N, F) commands of the hand, rad; `step` (N, 1) control steps
    done; `visual` (N, 5 E) with `visual=True`. Privileged: `object_position` (N, 3). Action (N, 6 + F), see `spaces`.
    The time limit and faults are truncations; success and a moved object are terminations.

    Args:
        simulator: Makes the worlds.
        robot: Its description says what the hand is.
        grasp_generator: Plans from the masked cloud.
        objects: Where the targets come from.
        feature_extractor: Describes the head camera's image for `visual`.
        scene: Puts objects into the room; None takes the standard table.
        masks: Finds the target in the image; None takes the simulator's own segmentation.
        targets: Names of the objects to grasp, one drawn for each episode; None takes all of the set.
        hand: Name of the hand; None takes the robot's first.
        num_envs: N.
        one_object_each: Give each world one object of its own, passing over those that are seldom planned.
        starts: Planned starts that each world keeps and draws again while a policy learns; 0 plans each afresh.
        threads: Threads that step physics.
        visual: Add what the head camera sees at every step.
        signals: How the object's motion is known to reward and end: ``object`` or ``hand``.
        max_steps: Time limit of an episode, control steps (thesis 2000; scripted episodes here need about 190).
        lift: Meters the object must rise.
        moved: Meters sideways at which it was moved too far.
        fallen: Meters its center may sink before it counts as toppled or fallen.
        x_range: Where objects are placed, world, meters.
        y_range: Where objects are placed, world, meters.
        camera: Name of the robot's camera; None takes the first.
        width: Pixels of the image that is planned from.
        height: Pixels of the image that is planned from.
        seed: Decides the starts.
    """

    def __init__(
        self,
        simulator: Callable[[], Simulator],
        robot: Robot,
        grasp_generator: GraspGenerator,
        objects: ObjectSet,
        feature_extractor: Callable[[], FeatureExtractor] | None = None,
        scene: Callable[[Sequence[ObjectSpec]], Scene] | None = None,
        masks: MaskProvider | None = None,
        *,
        targets: list[str] | None = None,
        hand: str | None = None,
        num_envs: Annotated[int, at_least(1)] = 1,
        one_object_each: bool = False,
        starts: Annotated[int, at_least(0)] = 0,
        threads: Annotated[int, at_least(1)] = 1,
        visual: bool = False,
        signals: Signals = "object",
        max_steps: Annotated[int, at_least(1)] = 250,
        lift: Annotated[float, above(0)] = 0.10,
        moved: Annotated[float, above(0)] = 0.10,
        fallen: Annotated[float, above(0)] = 0.02,
        x_range: tuple[float, float] = (-0.4, -0.3),
        y_range: tuple[float, float] = (-0.1, 0.1),
        camera: str | None = None,
        width: Annotated[int, at_least(16)] = 320,
        height: Annotated[int, at_least(16)] = 240,
        seed: int = 0,
    ) -> None:
        settings = TaskSettings(max_steps, lift, moved, fallen, x_range, y_range, camera, width, height)
        names = list(objects.names) if targets is None else list(targets)
        if not names:
            raise ConfigError("the grasping task has no target; expected at least one name of the object set")
        make_scene = scene or (lambda specs: Scene(objects=tuple(specs)))

        def world(number: int, chosen: Sequence[str]) -> GraspWorld:
            engine = simulator()
            engine.load(robot.description, make_scene([objects.get(name) for name in chosen]))
            return GraspWorld(
                engine, robot, grasp_generator, chosen, masks=masks, hand=hand, settings=settings, seed=seed + number
            )

        kept: list[list[StartState]] = []
        if one_object_each:
            worlds, kept = _one_each(world, names, num_envs, seed)
        else:
            worlds = [world(number, names) for number in range(num_envs)]
        if visual and feature_extractor is None:
            raise ConfigError(
                "the grasping task shows no images without a feature_extractor; add feature_extractor=NAME"
            )
        super().__init__(device="cpu", batch_size=torch.Size([len(worlds)]))
        encoder = ImageEncoder(feature_extractor()) if visual and feature_extractor is not None else None
        self.batch = TaskBatch(worlds, threads, signals)
        self._signals, self._starts = signals, starts
        self._visual = VisualStack(encoder, len(worlds)) if encoder is not None else None
        self._make_specs()
        self._set_seed(seed)
        for pool, found in zip(self.pools, kept, strict=False):
            pool.starts.extend(found)

    @property
    def worlds(self) -> list[GraspWorld]:
        """The worlds, one by one."""
        return self.batch.worlds

    @property
    def reasons(self) -> tuple[str, ...]:
        """Names of the ends of an episode."""
        return tuple(reason.name.lower() for reason in EndReason)

    @property
    def objects(self) -> tuple[str, ...]:
        """Names of the objects that episodes are about."""
        return tuple(dict.fromkeys(name for world in self.worlds for name in world.objects))

    @property
    def action_scale(self) -> torch.Tensor:
        """Return what an action of 1 changes in one step: (6 + F,), meters and radians."""
        return torch.from_numpy(self.batch.layout.action_scale.astype(np.float32))

    @property
    def observation_range(self) -> dict[str, tuple[torch.Tensor, torch.Tensor]]:
        """Return the range of the hand's actuators, and the box above the table in which objects stand."""
        layout, first = self.batch.layout, self.worlds[0]
        table, settings = first.simulator.scene.table, first.settings
        top = table.top if table is not None else 0.0
        (x0, x1), (y0, y1) = settings.x_range, settings.y_range
        limits = (layout.lower[layout.fingers], layout.upper[layout.fingers])
        box = (np.array([x0, y0, top]), np.array([x1, y1, top + OBJECT_HEIGHT]))
        ranges = {FINGERS: limits, OBJECT_CENTER: box}
        return {key: (torch.from_numpy(a).float(), torch.from_numpy(b).float()) for key, (a, b) in ranges.items()}

    @property
    def resamples(self) -> int:
        """Object poses without a plan so far, which were drawn again."""
        return sum(sum(world.plan_failures.values()) for world in self.worlds)

    def card(self) -> dict[str, Any]:
        """Return what distinguishes figures of this task."""
        first = self.worlds[0]
        return {
            "task": "grasp",
            "robot": first.robot.description.name,
            "hand": self.batch.layout.hand.name,
            "observation": "visual" if self._visual is not None else "state",
            "variation": "nominal",
            "signals": self._signals,
            "max_steps": first.settings.max_steps,
        }

    def _make_specs(self) -> None:
        n, layout = len(self.batch), self.batch.layout
        sizes = layout.sizes()
        if self._visual is not None:
            sizes[VISUAL] = self._visual.size
        self.observation_spec = Composite(
            {
                **{name: Unbounded(shape=(n, size), dtype=torch.float32) for name, size in sizes.items()},
                "success": Binary(n=1, shape=(n, 1), dtype=torch.bool),
                "fault": Binary(n=1, shape=(n, 1), dtype=torch.bool),
                "reason": Categorical(n=len(EndReason), shape=(n, 1), dtype=torch.int64),
            },
            shape=(n,),
        )
        self.action_spec = Bounded(low=-1.0, high=1.0, shape=(n, len(layout.action_scale)), dtype=torch.float32)
        self.reward_spec = Unbounded(shape=(n, 1), dtype=torch.float32)
        flag = Binary(n=1, shape=(n, 1), dtype=torch.bool)
        self.done_spec = Composite({"done": flag, "terminated": flag.clone(), "truncated": flag.clone()}, shape=(n,))

    def _set_seed(self, seed: int | None) -> None:
        seeds = np.random.SeedSequence(seed or 0).generate_state(len(self.batch))
        self.pools = [StartPool(world, self._starts, seed=int(s)) for world, s in zip(self.worlds, seeds, strict=True)]

    def draw(self, world: int, rng: np.random.Generator | None = None) -> StartState:
        """Return a start: planned afresh with `rng`, else one of the world's own."""
        return self.pools[world].draw() if rng is None else self.worlds[world].prepare(rng)

    def begin(self, world: int, start: Start) -> None:
        """Put one world at a start."""
        if not isinstance(start, StartState):
            raise ConfigError(f"a start of the grasping task is what draw() returns; got {type(start).__name__}")
        self.batch.begin(world, start)
        if self._visual is not None:
            self._visual.begin(world, self._seen(world))

    def observe(self) -> TensorDictBase:
        """Return the present observation of all worlds, not done."""
        n = len(self.batch)
        entries = self._entries()
        entries.update(zip(FLAGS, torch.zeros((len(FLAGS), n, 1), dtype=torch.bool).unbind(), strict=True))
        entries["reason"] = torch.zeros((n, 1), dtype=torch.int64)
        return TensorDict._new_unsafe(entries, batch_size=self.batch_size, device=self.device)

    def privileged(self) -> TensorDictBase:
        """Return the observation with the object's true position (N, 3)."""
        observation = self.observe()
        observation[OBJECT_POSITION] = torch.from_numpy(self.batch.object_positions().astype(np.float32))
        return observation

    def _entries(self) -> dict[str, torch.Tensor]:
        entries = {k: torch.from_numpy(v) for k, v in self.batch.observation().items()}
        if self._visual is not None:
            entries[VISUAL] = self._visual.stacked()
        return entries

    def advance(self, tensordict: TensorDictBase, active: Sequence[bool] | None = None) -> TensorDictBase:
        """Do one control step with the entry `action` (N, 6 + F)."""
        result = self.batch.step(tensordict["action"].detach().numpy(), active)
        if self._visual is not None:
            for world in range(len(self.batch)):
                if active is None or active[world]:
                    self._visual.push(world, self._seen(world))
        reason = result.reason
        terminated = (reason == EndReason.SUCCESS) | (reason == EndReason.MOVED)
        done = reason != EndReason.RUNNING
        entries = self._entries()
        entries["reward"] = torch.from_numpy(result.reward.astype(np.float32)[:, None])
        entries["reason"] = torch.from_numpy(reason[:, None])
        flags = np.stack([reason == EndReason.SUCCESS, result.fault, done, terminated, done & ~terminated])
        entries.update(zip(FLAGS, torch.from_numpy(flags[:, :, None]).unbind(), strict=True))
        return TensorDict._new_unsafe(entries, batch_size=self.batch_size, device=self.device)

    def fault_counts(self) -> dict[str, int]:
        """Return how many episodes ended so far, by name of the reason."""
        return self.batch.fault_filter.report()

    def render_world(
        self, world: int, view: CameraView | None = None, width: int = 320, height: int = 240
    ) -> NDArray[np.uint8]:
        """Return an image (height, width, 3) of one world, from `view` or from the head camera."""
        chosen, engine = self.worlds[world], self.worlds[world].simulator
        if view is not None:
            return engine.render(view, width, height, shadows=True).frame.rgb
        center = engine.object_pose(self.batch.object_name(world))[:3, 3]
        return engine.render(chosen.camera, width, height, look_at=center).frame.rgb

    def place(self, world: int, target: str, rng: np.random.Generator) -> None:
        """Reset one world and put a target on the table at random."""
        if target not in self.worlds[world].objects:
            raise ConfigError(unknown_name("target", target, self.worlds[world].objects))
        self.worlds[world].place(target, rng)

    def plan(self, world: int, target: str) -> Grasp | str:
        """Look at a target where it stands and plan its grasp; the reason in words where there is none."""
        found = self.worlds[world].plan(target)
        return found.grasp if isinstance(found, GraspPlan) else found.value

    def start_before(
        self, world: int, grasp: Grasp, distance: float, object_rest: NDArray[np.float64]
    ) -> StartState | None:
        """Return a start of the present world with the arm put `distance` meters before a grasp."""
        return self.worlds[world].start_before(grasp, distance, object_rest)

    def simulator(self, world: int) -> Simulator:
        """Return the simulator of one world."""
        return self.worlds[world].simulator

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Return everything that decides the future: worlds, episodes, starts, random numbers."""
        arrays: dict[str, np.ndarray] = {f"batch.{k}": v for k, v in self.batch.state_dict().items()}
        for world, pool in enumerate(self.pools):
            kept, text = pool.state_dict()
            arrays.update({f"pool.{world}.{k}": v for k, v in kept.items()})
            arrays[f"pool_text.{world}"] = np.frombuffer(text.encode(), dtype=np.uint8).copy()
        tensors = {name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in arrays.items()}
        if self._visual is not None:
            tensors["visual"] = self._visual.state_dict()
        return tensors

    def load_state_dict(self, state: Mapping[str, torch.Tensor]) -> None:
        """Restore what `state_dict` returned, in a task of the same worlds."""
        worlds = sum(name.startswith("pool_text.") for name in state)
        if worlds != len(self.batch) or ("visual" in state) != (self._visual is not None):
            raise CheckpointError(
                f"the state is of a grasping task of {worlds} worlds {'with' if 'visual' in state else 'without'} "
                f"images; this one has {len(self.batch)} {'with' if self._visual is not None else 'without'}"
            )
        for name, value in self.batch.state_dict().items():
            given = state.get(f"batch.{name}")
            if given is None or tuple(given.shape) != value.shape:
                raise CheckpointError(
                    f"the state is of another grasping task: '{name}' has shape "
                    f"{None if given is None else tuple(given.shape)}; expected {value.shape}"
                )
        arrays = {name: value.numpy() for name, value in state.items() if name != "visual"}
        self.batch.load_state_dict(part(arrays, "batch."))
        for world, pool in enumerate(self.pools):
            text = bytes(arrays[f"pool_text.{world}"]).decode()
            pool.load_state_dict(part(arrays, f"pool.{world}."), text)
        if self._visual is not None:
            self._visual.load_state_dict(state["visual"])

    def _seen(self, world: int) -> NDArray[np.uint8]:
        return self.worlds[world].look(self.batch.object_name(world)).frame.rgb

    def close(self, *, raise_if_closed: bool = False) -> None:
        """Free every simulator; may be called twice."""
        self.batch.close()
        if not self.is_closed:
            super().close(raise_if_closed=raise_if_closed)


def _one_each(
    make: Callable[[int, Sequence[str]], GraspWorld], names: Sequence[str], count: int, seed: int
) -> tuple[list[GraspWorld], list[list[StartState]]]:
    """Build one world for each object that is planned often enough, with its first starts, until there are `count`."""
    worlds: list[GraspWorld] = []
    starts: list[list[StartState]] = []
    for name in names:
        world = make(len(worlds), [name])
        found = _first_starts(world, name, np.random.default_rng([seed, len(worlds)]))
        if len(found) < MIN_PLANS:
            log.info("%s is left out: only %d plans for %d poses", name, len(found), PLACEMENTS)
            world.simulator.close()
            continue
        worlds.append(world)
        starts.append(found)
        log.info("%d of %d objects have a world and first plans", len(worlds), count)
        if len(worlds) == count:
            return worlds, starts
    for world in worlds:
        world.simulator.close()
    raise ConfigError(f"{len(worlds)} of {len(names)} objects are planned often enough; expected {count} (num_envs)")


def _first_starts(world: GraspWorld, name: str, rng: np.random.Generator) -> list[StartState]:
    found: list[StartState] = []
    for _ in range(PLACEMENTS):
        rest = world.place(name, rng)
        plan = world.plan(name)
        if isinstance(plan, GraspPlan):
            found.append(world.approach(plan, rest))
            if len(found) == MIN_PLANS:
                break
    return found
