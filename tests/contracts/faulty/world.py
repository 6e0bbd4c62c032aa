"""Faulty robots, simulators, object sets and data sets."""

from dataclasses import replace

import numpy as np

from icub_core.data import Instance
from icub_core.interfaces.robot import GazeSolution
from icub_core.scene import Scene
from icub_testing.tiny.robot import TinyRobot, _describe
from icub_testing.tiny.simulator import TinySimulator
from icub_testing.tiny.things import COLORS, TinyDataset, TinyEpisode, TinyEpisodes, TinyObjects

from .base import breaks


@breaks("robot", "check_description")
class DescribesAnew(TinyRobot):
    @property
    def description(self):
        return _describe()


@breaks("robot", "check_home")
class HomeOutsideLimits(TinyRobot):
    def __init__(self) -> None:
        super().__init__()
        self._description = replace(self._description, home={**self._description.home, "gantry_x": 0.1})


@breaks("robot", "check_frames")
class MissingFingertip(TinyRobot):
    def __init__(self) -> None:
        super().__init__()
        hand = self._description.hand()
        wrong = replace(hand, fingertips=("no_such_tip", *hand.fingertips[1:]))
        self._description = replace(self._description, hands={hand.name: wrong})


@breaks("robot", "check_forward_kinematics")
class RoundsJoints(TinyRobot):
    def forward_kinematics(self, q, frame):
        T = super().forward_kinematics(q, frame)
        q[3] = round(q[3], 3)
        return T


@breaks("robot", "check_jacobian")
class AngularFirst(TinyRobot):
    def jacobian(self, q, frame):
        return np.roll(super().jacobian(q, frame), 3, axis=0)


@breaks("robot", "check_pose_and_jacobian")
class ForgetsTheJacobian(TinyRobot):
    def pose_and_jacobian(self, q, frame):
        pose, J = super().pose_and_jacobian(q, frame)
        return pose, 0 * J


@breaks("robot", "check_inverse_kinematics")
class ClaimsToReach(TinyRobot):
    def inverse_kinematics(self, T_world_frame, q_start, frame, **options):
        solution = super().inverse_kinematics(T_world_frame, q_start, frame, **options)
        q = solution.q.copy()
        q[1] = np.clip(q[1] + 0.01, self.description.lower[1], self.description.upper[1])
        return replace(solution, q=q)


@breaks("robot", "check_ik_limits")
class LeavesTheLimits(TinyRobot):
    def inverse_kinematics(self, T_world_frame, q_start, frame, **options):
        solution = super().inverse_kinematics(T_world_frame, q_start, frame, **options)
        q = solution.q.copy()
        if not solution.reached and np.isfinite(T_world_frame).all():
            q[:3] = T_world_frame[:3, 3]
        return replace(solution, q=q)


@breaks("robot", "check_ik_unreachable")
class RaisesForNaN(TinyRobot):
    def inverse_kinematics(self, T_world_frame, q_start, frame, **options):
        if np.isnan(T_world_frame).any():
            raise ValueError("array must not contain infs or NaNs")
        return super().inverse_kinematics(T_world_frame, q_start, frame, **options)


@breaks("robot", "check_ik_group")
class MovesTheFingers(TinyRobot):
    def inverse_kinematics(self, T_world_frame, q_start, frame, **options):
        solution = super().inverse_kinematics(T_world_frame, q_start, frame, **options)
        q = solution.q.copy()
        q[-1] += 0.3
        return replace(solution, q=q)


@breaks("robot", "check_ik_batch")
class NeedsTargets(TinyRobot):
    def inverse_kinematics_batch(self, T_world_frames, q_start, frame, **options):
        np.concatenate([T[None] for T in T_world_frames])
        return super().inverse_kinematics_batch(T_world_frames, q_start, frame, **options)


@breaks("robot", "check_gaze")
class TurnsItsHeadOff(TinyRobot):
    def gaze(self, point, q_start, camera=None):
        q = q_start.copy()
        q[-1] = 10.0
        return GazeSolution(q, True, 0.0)


@breaks("robot", "check_collisions")
class BumpsIntoItself(TinyRobot):
    def collisions(self, q, table=None, margin=0.0):
        return (("tiny_hand", "rear_base"),)


@breaks("simulator", "check_shortcuts")
class CommandedNotMeasured(TinySimulator):
    def actuator_positions(self):
        super().actuator_positions()
        return self._targets


@breaks("simulator", "check_appearance")
class MovesWhatItPaints(TinySimulator):
    def set_appearance(self, *, table=None, floor=None, backdrop=None, lights=None):
        lower = replace(self.scene.table, material=table, center=(-0.68, 0.0, 0.85))
        self._scene = replace(self.scene, table=lower)


@breaks("simulator", "check_before_load")
class StepsNothing(TinySimulator):
    def step(self, n=1):
        if self._scene is not None:
            super().step(n)


@breaks("simulator", "check_reset")
class LeavesObjectsThere(TinySimulator):
    def reset(self):
        before = getattr(self, "_poses", None)
        super().reset()
        if before is not None and len(before) == len(self._poses):
            self._poses = before


@breaks("simulator", "check_time")
class CountsOneTooMany(TinySimulator):
    def step(self, n=1):
        super().step(n)
        self._steps += n == 7  # as the check steps, and no tick does


@breaks("simulator", "check_tick")
class TicksAreSteps(TinySimulator):
    def tick(self, seconds):
        self.step(1)


@breaks("simulator", "check_image")
class PhotographsFromTheOtherSide(TinySimulator):
    def image(self, camera, width=320, height=240):
        return self.render(camera, width, height, look_at=np.zeros(3)).frame


@breaks("simulator", "check_hand_and_object")
class ReadsTheHandOnce(TinySimulator):
    pose = None

    def hand_and_object(self, frame, hand, name):
        answer = super().hand_and_object(frame, hand, name)
        self.pose = answer[0] if self.pose is None else self.pose
        return self.pose, *answer[1:]


@breaks("simulator", "check_repeatable")
class ShakesObjects(TinySimulator):
    def set_object_pose(self, name, T_world_object):
        shaken = T_world_object.copy()
        shaken[0, 3] += 1e-12 * np.random.default_rng().random()
        super().set_object_pose(name, shaken)


@breaks("simulator", "check_joint_order")
class TeleportsInMotion(TinySimulator):
    def set_joint_positions(self, q):
        super().set_joint_positions(q)
        self._dq = self._dq + 0.1


@breaks("simulator", "check_kinematics")
class LinksAMillimetreOff(TinySimulator):
    def link_pose(self, link):
        T = super().link_pose(link)
        T[2, 3] += 0.0 if link == "tiny_base" else 1e-3
        return T


@breaks("simulator", "check_targets")
class ReversesTargets(TinySimulator):
    def set_targets(self, targets):
        super().set_targets(targets[::-1])


@breaks("simulator", "check_object_poses")
class ObjectsSink(TinySimulator):
    def step(self, n=1):
        super().step(n)
        self._poses[:, 2, 3] -= 5e-4 * n


@breaks("simulator", "check_unknown_names")
class UnknownIsUntouched(TinySimulator):
    def touching(self, name):
        return name in [spec.name for spec in self.scene.objects] and super().touching(name)


@breaks("simulator", "check_save_and_restore")
class ForgetsTargets(TinySimulator):
    def restore_state(self, state):
        super().restore_state(state)
        self._targets = self._A @ self._q + self._b


@breaks("simulator", "check_rendering")
class DepthAlongTheRay(TinySimulator):
    def render(self, camera, width=320, height=240, **options):
        rendering = super().render(camera, width, height, **options)
        K = rendering.frame.intrinsics
        columns, rows = np.meshgrid(np.arange(width), np.arange(height))
        length = np.sqrt(1 + ((columns - K[0, 2]) / K[0, 0]) ** 2 + ((rows - K[1, 2]) / K[1, 1]) ** 2)
        depth = (rendering.frame.depth * length * 1.02).astype(np.float32)
        return replace(rendering, frame=replace(rendering.frame, depth=depth))


@breaks("simulator", "check_pixels")
class PixelCornersAreWholeNumbers(TinySimulator):
    def render(self, camera, width=320, height=240, **options):
        rendering = super().render(camera, width, height, **options)
        K = rendering.frame.intrinsics.copy()
        K[:2, 2] = width / 2, height / 2
        return replace(rendering, frame=replace(rendering.frame, intrinsics=K))


@breaks("simulator", "check_background")
class SkyIsFarAway(TinySimulator):
    def render(self, camera, width=320, height=240, **options):
        rendering = super().render(camera, width, height, **options)
        depth = np.where(rendering.frame.depth == 0, np.float32(100.0), rendering.frame.depth)
        return replace(rendering, frame=replace(rendering.frame, depth=depth))


@breaks("simulator", "check_segmentation")
class AlwaysSegments(TinySimulator):
    def render(self, camera, width=320, height=240, **options):
        return super().render(camera, width, height, **{**options, "segmentation": True})


@breaks("simulator", "check_cameras")
class NeverTurnsTheCamera(TinySimulator):
    def render(self, camera, width=320, height=240, **options):
        return super().render(camera, width, height, **{**options, "look_at": None})


@breaks("simulator", "check_contacts")
class FeelsNothing(TinySimulator):
    def touching(self, name):
        super().touching(name)
        return False


@breaks("simulator", "check_faults")
class HidesFaults(TinySimulator):
    def faults(self):
        return ()


@breaks("simulator", "check_load_again")
class AddsWorlds(TinySimulator):
    def load(self, robot, scene):
        before = self._scene.objects if self._scene is not None else ()
        super().load(robot, Scene(objects=(*before, *scene.objects)))


@breaks("simulator", "check_close")
class ClosesOnce(TinySimulator):
    closed = 0

    def close(self):
        self.closed += 1
        if self.closed == 2:
            raise RuntimeError("already closed")


@breaks("objects", "check_names")
class TurnsItsNames(TinyObjects):
    calls = 0

    @property
    def names(self):
        self.calls += 1
        names = super().names
        return names[self.calls % 3 :] + names[: self.calls % 3]


@breaks("objects", "check_get")
class Shouts(TinyObjects):
    def get(self, name):
        return replace(super().get(name), name=name.upper())


@breaks("objects", "check_repeatable")
class WeighsAtRandom(TinyObjects):
    def get(self, name):
        return replace(super().get(name), mass=0.1 + float(np.random.default_rng().random()))


@breaks("objects", "check_unknown")
class PlainKeyError(TinyObjects):
    def get(self, name):
        assert COLORS[name]
        return super().get(name)


@breaks("objects", "check_extents")
class HalfTheHalfExtents(TinyObjects):
    def get(self, name):
        spec = super().get(name)
        return replace(spec, half_extents=tuple(half / 2 for half in spec.half_extents))


@breaks("dataset", "check_classes")
class RepeatsAClass(TinyDataset):
    @property
    def classes(self):
        return (*super().classes, "red")


@breaks("dataset", "check_length")
class WrapsAround(TinyDataset):
    def __getitem__(self, index):
        return super().__getitem__(index % len(self))


@breaks("dataset", "check_splits")
class NamesASplitTwice(TinyDataset):
    @property
    def splits(self):
        return ("all", "all")


@breaks("dataset", "check_close")
class ClosesItsFilesOnce(TinyDataset):
    closed = False

    def close(self):
        if self.closed:
            raise ValueError("already closed")
        self.closed = True


@breaks("dataset", "check_labels")
class UnknownLabel(TinyDataset):
    def __getitem__(self, index):
        frame, instances = super().__getitem__(index)
        return frame, tuple(replace(instance, label="disc") for instance in instances)


@breaks("dataset", "check_repeatable")
class NoisyDepth(TinyDataset):
    def __getitem__(self, index):
        frame, instances = super().__getitem__(index)
        noise = np.random.default_rng().random(frame.depth.shape).astype(np.float32)
        return replace(frame, depth=frame.depth + 1e-3 * noise), instances


@breaks("dataset", "check_masks")
class SmallMasks(TinyDataset):
    def __getitem__(self, index):
        frame, instances = super().__getitem__(index)
        return frame, tuple(Instance(i.label, i.score, i.box, i.mask[::2, ::2].copy()) for i in instances)


@breaks("dataset", "check_iteration")
class BeginsAtTheSecond(TinyDataset):
    def __iter__(self):
        return (self[i] for i in range(1, len(self)))


class ChangedEpisode(TinyEpisode):
    def __init__(self, color, change) -> None:
        super().__init__(color, 3)
        self._change = change

    def __getitem__(self, index):
        return self._change(super().__getitem__(index), index)


class ChangesSteps(TinyEpisodes):
    def __init__(self) -> None:
        super().__init__()
        self._episodes = tuple(ChangedEpisode(color, self.change) for color in COLORS)


@breaks("episodes", "check_length")
class WrapsAroundEpisodes(TinyEpisodes):
    def __getitem__(self, index):
        return super().__getitem__(index % len(self))

    def __iter__(self):
        return (self[i] for i in range(len(self)))


@breaks("episodes", "check_words")
class SaysNothing(TinyEpisodes):
    def __init__(self) -> None:
        super().__init__()
        silent = type("SilentEpisode", (TinyEpisode,), {"instruction": None})
        self._episodes = tuple(silent(color, 3) for color in COLORS)


@breaks("episodes", "check_repeatable")
class NoisyActions(ChangesSteps):
    def change(self, step, index):
        noise = np.random.default_rng().random(3)
        return replace(step, state={**step.state, "position": step.state["position"] + 1e-3 * noise})


@breaks("episodes", "check_images")
class FloatImages(ChangesSteps):
    def change(self, step, index):
        return replace(step, rgb={"camera": step.rgb["camera"] / np.float32(255)})


@breaks("episodes", "check_numbers")
class LosesAVelocity(ChangesSteps):
    def change(self, step, index):
        lost = np.full(3, np.nan) if index == 1 else step.state["velocity"]
        return replace(step, state={**step.state, "velocity": lost})


@breaks("episodes", "check_sizes")
class LastActionIsLonger(ChangesSteps):
    def change(self, step, index):
        return replace(step, action=np.append(step.action, 0.0)) if index == 2 else step


@breaks("episodes", "check_iteration")
class BeginsAtTheSecondEpisode(TinyEpisodes):
    def __iter__(self):
        return (self[i] for i in range(1, len(self)))
