"""The stages plan and grasp: poses from what the camera sees, episodes of a policy, a film of the last ones."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from icub_core.geometry import look_at
from icub_core.grasping.env import GraspEnv
from icub_core.grasping.evaluation import EpisodeResults, evaluate
from icub_core.grasping.plan import GraspPlan
from icub_core.grasping.task import GraspTask
from icub_core.interfaces.policy import Policy
from icub_core.pipeline.context import RunContext
from icub_core.pipeline.pictures import captioned, save_animation
from icub_core.pipeline.settings import GraspSettings
from icub_core.scene import CameraView

PLANS_TRIED = 10
FILM_EVERY = 4
"""Control steps between two pictures of the film: ten a second."""
FILM_SIZE = (320, 240)
FILM_VIEW = CameraView(look_at([-0.92, 0.5, 1.32], [-0.27, 0.03, 1.13]), fovy=0.78)
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
    """Let the policy learn within its budget, then evaluate it on fresh starts and film the last episodes."""
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
    film = Film(settings.episodes - settings.video_episodes)
    results = evaluate(
        policy,
        env,
        settings.episodes,
        seed=context.seed + 1_000_000,  # never the starts that were learned from
        recorder=film.record,
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
            "grasp.redrawn_poses": results.redraws,
            **{f"grasp.ended_{reason}": count for reason, count in results.ends().items()},
        }
    )
    pictures = film.pictures(results)
    if pictures:
        path = context.run_dir / "grasp.gif"
        save_animation(path, pictures, frames_per_second=10)
        context.pictures.append(("The last grasps", path))
    return results


class Film:
    """Pictures of the last episodes, kept by episode so that worlds running side by side do not mix."""

    def __init__(self, first_episode: int) -> None:
        """Film episodes from number `first_episode` on."""
        self._first = first_episode
        self._pictures: dict[int, list[np.ndarray]] = {}
        self._steps: dict[int, int] = {}

    def record(self, world: int, env: GraspEnv, episode: int) -> None:
        """Take a picture when it is time."""
        if episode < self._first:
            return
        step = self._steps[episode] = self._steps.get(episode, -1) + 1
        if step % FILM_EVERY == 0:
            picture = env.batch.tasks[world].simulator.render(FILM_VIEW, *FILM_SIZE, shadows=True)
            self._pictures.setdefault(episode, []).append(picture.frame.rgb)

    def pictures(self, results: EpisodeResults) -> Sequence[np.ndarray]:
        """Return all pictures, episode after episode, each saying how its episode ended."""
        film = []
        for episode, pictures in sorted(self._pictures.items()):
            verdict = "grasped" if results.success[episode] else "failed"
            film += [captioned(p, f"{results.objects[episode]}, episode {episode}: {verdict}") for p in pictures]
        return film
