"""The stages plan and grasp: poses from what the camera sees, episodes of a policy, a video of the last ones."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from tensordict import TensorDictBase

from icub_core.data import Grasp
from icub_core.geometry import look_at
from icub_core.hooks import Events
from icub_core.interfaces.abilities import Learns, TriesGrasps
from icub_core.interfaces.policy import LearnReport, Policy
from icub_core.interfaces.task import RUNNING, Task
from icub_core.rollouts import EpisodeResults, evaluate
from icub_core.run import Run
from icub_core.scene import CameraView
from icub_pipelines.images import captioned, save_animation
from icub_pipelines.settings import GraspSettings

EVALUATION_SEED = 1_000_000
"""Added to the run's seed, so that evaluation never meets the starts that were learned from."""
PLANS_TRIED = 10
VIDEO_EVERY = 4
"""Control steps between two images of the video: ten a second."""
VIDEO_SIZE = (320, 240)
VIDEO_VIEW = CameraView(look_at([-0.92, 0.5, 1.32], [-0.27, 0.03, 1.13]), fovy=0.78)
"""From across the table, on the side of the right hand."""


def plan(run: Run, task: Task, target: str) -> None:
    """Place the target at random a few times, look, and plan."""
    if not isinstance(task, TriesGrasps):
        run.note(f"the task '{type(task).__name__}' plans no grasps: the stage plan does nothing")
        return
    rng = run.rng("plan")
    found, spent = 0, 0.0
    for number in range(PLANS_TRIED):
        task.place(0, target, rng)
        started = time.perf_counter()
        answer = task.plan(0, target)
        spent += time.perf_counter() - started
        if isinstance(answer, Grasp):
            found += 1
            run.events.emit("icub_grasp_selected", grasp=answer)
        run.progress((number + 1) / PLANS_TRIED, f"{found} of {number + 1} placements have a plan")
    run.record({"plan.share_with_plan": found / PLANS_TRIED, "plan.seconds_each": spent / PLANS_TRIED})


def grasp(run: Run, task: Task, policy: Policy, settings: GraspSettings) -> EpisodeResults:
    """Let the policy learn within its budget, then evaluate it on fresh starts and record the last episodes."""
    report = LearnReport()
    if isinstance(policy, Learns):
        report = policy.learn(task, run.run_dir / "policy", lambda share, text: run.progress(0.7 * share, text))
    if report.env_steps:
        run.record(
            {
                "grasp.learn_seconds": report.seconds,
                "grasp.learn_env_steps": report.env_steps,
                "grasp.learn_updates": report.updates,
                **{f"grasp.learn_{key}": value for key, value in report.metrics.items()},
            }
        )
    video = Video(settings.episodes - settings.video_episodes)
    seed = run.seed + EVALUATION_SEED
    announce = Announcer(run.events, seed, task.reasons)

    def record(world: int, task: Task, episode: int, step: TensorDictBase) -> None:
        video.record(world, task, episode)
        announce.record(episode, step)

    results = evaluate(
        policy,
        task,
        settings.episodes,
        seed=seed,
        recorder=record,
        progress=lambda share, text: run.progress(0.7 + 0.3 * share, text),
    )
    low, high = results.interval
    run.record(
        {
            "grasp.success_rate": results.success_rate,
            "grasp.success_low": low,
            "grasp.success_high": high,
            "grasp.episodes": len(results),
            "grasp.faults": results.faults,
            "grasp.redrawn_poses": results.resamples,
            **{f"grasp.ended_{reason}": count for reason, count in results.ends().items()},
        }
    )
    images = video.images(results)
    if images:
        path = run.run_dir / "grasp.gif"
        save_animation(path, images, frames_per_second=10)
        run.images.append(("The last grasps", path))
    return results


class Announcer:
    """Tells listeners about episodes and their steps."""

    def __init__(self, events: Events, seed: int, reasons: Sequence[str]) -> None:
        """Announce to `events`; `seed` is that of the evaluation's starts, `reasons` the task's."""
        self._events, self._seed, self._reasons = events, seed, reasons
        self._steps: dict[int, int] = {}
        self._wants_steps = events.wants("icub_step")

    def record(self, episode: int, step: TensorDictBase) -> None:
        """Announce one step, and the start or end of its episode with the first and last."""
        if episode not in self._steps:
            self._events.emit("icub_episode_start", episode=episode, seed=self._seed)
        self._steps[episode] = self._steps.get(episode, 0) + 1
        if self._wants_steps:
            self._events.emit("icub_step", observation=step, action=step["action"], reward=float(step["reward"]))
        reason = int(step["reason"])
        if reason != RUNNING:
            self._events.emit(
                "icub_episode_end",
                episode=episode,
                success=bool(step["success"]),
                steps=self._steps[episode],
                reason=self._reasons[reason],
            )


class Video:
    """Images of the last episodes, kept by episode so that worlds running side by side do not mix."""

    def __init__(self, first_episode: int) -> None:
        """Record episodes from number `first_episode` on."""
        self._first = first_episode
        self._images: dict[int, list[np.ndarray]] = {}
        self._steps: dict[int, int] = {}

    def record(self, world: int, task: Task, episode: int) -> None:
        """Take an image when it is time."""
        if episode < self._first:
            return
        step = self._steps[episode] = self._steps.get(episode, -1) + 1
        if step % VIDEO_EVERY == 0:
            self._images.setdefault(episode, []).append(task.render_world(world, VIDEO_VIEW, *VIDEO_SIZE))

    def images(self, results: EpisodeResults) -> Sequence[np.ndarray]:
        """Return all images, episode after episode, each saying how its episode ended."""
        video = []
        for episode, images in sorted(self._images.items()):
            outcome = "grasped" if results.success[episode] else "failed"
            video += [captioned(p, f"{results.objects[episode]}, episode {episode}: {outcome}") for p in images]
        return video
