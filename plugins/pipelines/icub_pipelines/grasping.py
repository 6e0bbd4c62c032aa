"""The stages plan and grasp: poses from what the camera sees, episodes of a policy, a video of the last ones."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from tensordict import TensorDictBase

from icub_core.geometry import look_at
from icub_core.hooks import Events
from icub_core.interfaces.policy import Policy
from icub_core.scene import CameraView
from icub_pipelines.context import RunContext
from icub_pipelines.images import captioned, save_animation
from icub_pipelines.settings import GraspSettings
from icub_tasks.grasping.env import GraspEnv
from icub_tasks.grasping.evaluation import EpisodeResults, evaluate
from icub_tasks.grasping.plan import GraspPlan
from icub_tasks.grasping.task import GraspTask
from icub_tasks.grasping.termination import EndReason

EVALUATION_SEED = 1_000_000
"""Added to the run's seed, so that evaluation never meets the starts that were learned from."""
PLANS_TRIED = 10
VIDEO_EVERY = 4
"""Control steps between two images of the video: ten a second."""
VIDEO_SIZE = (320, 240)
VIDEO_VIEW = CameraView(look_at([-0.92, 0.5, 1.32], [-0.27, 0.03, 1.13]), fovy=0.78)
"""From across the table, on the side of the right hand."""


def plan(context: RunContext, task: GraspTask, target: str) -> None:
    """Place the target at random a few times, look, and plan."""
    rng = context.rng("plan")
    found, spent = 0, 0.0
    for number in range(PLANS_TRIED):
        task.place(target, rng)
        started = time.perf_counter()
        answer = task.plan(target)
        spent += time.perf_counter() - started
        if isinstance(answer, GraspPlan):
            found += 1
            context.events.emit("icub_grasp_selected", grasp=answer.grasp)
        context.progress((number + 1) / PLANS_TRIED, f"{found} of {number + 1} placements have a plan")
    context.record({"plan.share_with_plan": found / PLANS_TRIED, "plan.seconds_each": spent / PLANS_TRIED})


def grasp(context: RunContext, env: GraspEnv, policy: Policy, settings: GraspSettings) -> EpisodeResults:
    """Let the policy learn within its budget, then evaluate it on fresh starts and video the last episodes."""
    report = policy.learn(env, context.run_dir / "policy", lambda share, text: context.progress(0.7 * share, text))
    if report.env_steps:
        context.record(
            {
                "grasp.learn_seconds": report.seconds,
                "grasp.learn_env_steps": report.env_steps,
                "grasp.learn_updates": report.updates,
                **{f"grasp.learn_{key}": value for key, value in report.metrics.items()},
            }
        )
    video = Video(settings.episodes - settings.video_episodes)
    seed = context.seed + EVALUATION_SEED
    announce = Announcer(context.events, seed)

    def record(world: int, env: GraspEnv, episode: int, step: TensorDictBase) -> None:
        video.record(world, env, episode)
        announce.record(episode, step)

    results = evaluate(
        policy,
        env,
        settings.episodes,
        seed=seed,
        recorder=record,
        progress=lambda share, text: context.progress(0.7 + 0.3 * share, text),
    )
    low, high = results.interval
    context.record(
        {
            "grasp.success_rate": results.success_rate,
            "grasp.success_low": low,
            "grasp.success_high": high,
            "grasp.episodes": len(results),
            "grasp.faults": results.faults,
            "grasp.resampled_poses": results.resamples,
            **{f"grasp.ended_{reason}": count for reason, count in results.ends().items()},
        }
    )
    pictures = video.pictures(results)
    if pictures:
        path = context.run_dir / "grasp.gif"
        save_animation(path, pictures, frames_per_second=10)
        context.pictures.append(("The last grasps", path))
    return results


class Announcer:
    """Tells listeners about episodes and their steps."""

    def __init__(self, events: Events, seed: int) -> None:
        """Announce to `events`; `seed` is that of the evaluation's starts."""
        self._events, self._seed = events, seed
        self._steps: dict[int, int] = {}
        self._wants_steps = events.wants("icub_step")

    def record(self, episode: int, step: TensorDictBase) -> None:
        """Announce one step, and the start or end of its episode with the first and last."""
        if episode not in self._steps:
            self._events.emit("icub_episode_start", episode=episode, seed=self._seed)
        self._steps[episode] = self._steps.get(episode, 0) + 1
        if self._wants_steps:
            self._events.emit("icub_step", observation=step, action=step["action"], reward=float(step["reward"]))
        reason = EndReason(int(step["reason"]))
        if reason != EndReason.RUNNING:
            self._events.emit(
                "icub_episode_end",
                episode=episode,
                success=reason == EndReason.SUCCESS,
                steps=self._steps[episode],
                reason=reason.name.lower(),
            )


class Video:
    """Images of the last episodes, kept by episode so that worlds running side by side do not mix."""

    def __init__(self, first_episode: int) -> None:
        """Film episodes from number `first_episode` on."""
        self._first = first_episode
        self._pictures: dict[int, list[np.ndarray]] = {}
        self._steps: dict[int, int] = {}

    def record(self, world: int, env: GraspEnv, episode: int) -> None:
        """Take a image when it is time."""
        if episode < self._first:
            return
        step = self._steps[episode] = self._steps.get(episode, -1) + 1
        if step % VIDEO_EVERY == 0:
            picture = env.batch.tasks[world].simulator.render(VIDEO_VIEW, *VIDEO_SIZE, shadows=True)
            self._pictures.setdefault(episode, []).append(picture.frame.rgb)

    def pictures(self, results: EpisodeResults) -> Sequence[np.ndarray]:
        """Return all images, episode after episode, each saying how its episode ended."""
        video = []
        for episode, pictures in sorted(self._pictures.items()):
            outcome = "grasped" if results.success[episode] else "failed"
            video += [captioned(p, f"{results.objects[episode]}, episode {episode}: {outcome}") for p in pictures]
        return video
