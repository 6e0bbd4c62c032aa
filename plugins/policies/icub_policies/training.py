"""The loop of every learning policy: act, store, update, evaluate now and then, keep the best, checkpoint."""

from __future__ import annotations

import contextlib
import logging
import math
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDictBase

from icub_core.errors import CheckpointError
from icub_core.interfaces.abilities import HasWeights
from icub_core.interfaces.policy import LearnReport, Policy, Progress
from icub_core.interfaces.task import Start, Task
from icub_core.rollouts import run_episodes
from icub_policies.checkpoint import read_tensors, write_tensors
from icub_policies.inputs import Inputs
from icub_policies.replay import CUT, RUNNING, TERMINAL, Batch, Replay, concatenate
from icub_policies.sac import Sac
from icub_support.weights import part

log = logging.getLogger(__name__)

CHECKPOINT = "training.safetensors"
CHECKPOINT_VERSION = 2
RECENT_EPISODES = 100
IMITATION_LEARNING_RATE = 1e-3
EVALUATION_SEED = 987_654_321
"""Of the starts on which the best weights are chosen; test seeds are the caller's and differ."""


@dataclass(frozen=True)
class TrainingSettings:
    """Numbers of the loop.

    Attributes:
        seconds: Wall-clock budget, or None.
        env_steps: Budget in control steps of all worlds together, or None.
        updates_per_step: Critic updates for each control step of one world.
        imitation_updates: Updates at the very start that let the actor imitate the demonstrations.
        warm_up_updates: Updates of the critics that follow, on demonstrations alone.
        imitation: Weight of imitation in the actor's loss at first; falls linearly to 0.
        imitation_until: Share of the budget after which nothing is imitated.
        critic_updates: Updates after which the actor begins to learn (residuals: critics first know the object).
        warm_up_steps: Control steps collected before the first update.
        demonstration_share: Share of every batch drawn from the demonstrations.
        noise_memory: Share of the exploration noise that a step hands on to the next; noise that lasts moves the hand
            somewhere instead of shaking it (Eberhard et al., "Pink noise is all you need", ICLR 2023).
        evaluate_every: Control steps between two evaluations.
        evaluation_episodes: Episodes of an evaluation.
        checkpoint_every: Seconds between two checkpoints.
    """

    seconds: float | None = None
    env_steps: int | None = None
    updates_per_step: float = 0.25
    imitation_updates: int = 0
    warm_up_updates: int = 0
    imitation: float = 0.0
    imitation_until: float = 0.5
    critic_updates: int = 0
    warm_up_steps: int = 0
    demonstration_share: float = 0.5
    noise_memory: float = 0.95
    evaluate_every: int = 40_000
    evaluation_episodes: int = 32
    checkpoint_every: float = 60.0


@dataclass
class _Count:
    env_steps: int = 0
    updates_owed: float = 0.0
    episodes: int = 0
    faults: int = 0
    seconds: float = 0.0
    next_evaluation: int = 0
    best_success: float = -1.0
    best_return: float = -np.inf
    first_success: float = -1.0
    last_success: float = -1.0
    best_env_steps: int = 0
    recent: deque[bool] = field(default_factory=lambda: deque(maxlen=RECENT_EPISODES))


class Trainer:
    """Trains a `Sac` in a task.

    Args:
        task: Worlds to learn in.
        sac: Learner.
        inputs: What it sees of an observation.
        replay: Memory of what the learner did.
        policy: Acts deterministically with the learner's present weights; evaluated now and then.
        settings: Numbers.
        run_dir: Where the checkpoint lies; an unfinished one there is continued. None keeps none.
        exports: Where the policy is saved whenever an evaluation is the best so far.
        demonstrations: Kept for ever beside the replay, or None.
        base: Frozen policy's action (N, a) of network inputs (N, d), for residuals.
        progress: Told what share is done.
    """

    def __init__(
        self,
        task: Task,
        sac: Sac,
        inputs: Inputs,
        replay: Replay,
        policy: Policy,
        settings: TrainingSettings,
        run_dir: Path | None,
        *,
        exports: Path | None = None,
        demonstrations: Replay | None = None,
        base: Callable[[torch.Tensor], torch.Tensor] | None = None,
        progress: Progress | None = None,
    ) -> None:
        self._task, self._sac, self._inputs, self._replay, self._policy = task, sac, inputs, replay, policy
        self._settings, self._path = settings, run_dir / CHECKPOINT if run_dir is not None else None
        self._exports, self._demonstrations, self._base = exports, demonstrations, base
        self._progress = progress or (lambda share, text: None)
        self._count = _Count()
        self._best = {name: value.clone() for name, value in sac.weights().items()}
        self._generator = torch.Generator().manual_seed(sac.generator.initial_seed() + 1)
        self._evaluation_starts: list[list[Start]] = []
        self._resumed = False
        self._noise = sac.noise(task.batch_size[0])
        self._shown = 0 if demonstrations is None else round(settings.demonstration_share * sac.settings.batch)

    def run(self) -> LearnReport:
        """Train until the budget is spent, then leave the best evaluated weights in the learner."""
        begun, spent = time.monotonic(), self._count.seconds
        before = torch.get_float32_matmul_precision()
        torch.set_float32_matmul_precision("medium")  # oneDNN instead of MKL: faster on many CPUs, the same error there
        try:
            if self._resumed:
                kept = self._task.state_dict()
                self._plan_evaluation()
                self._task.load_state_dict(kept)
                observation = self._task.observe()
            else:
                self._plan_evaluation()
                self._warm_up()
                observation = self._task.reset()
            saved = time.monotonic()
            while not self._finished():
                if self._count.env_steps >= self._count.next_evaluation:
                    self._evaluate()
                observation = self._step(observation)
                self._update()
                self._count.seconds = spent + time.monotonic() - begun
                if time.monotonic() - saved > self._settings.checkpoint_every:
                    self._save()
                    saved = time.monotonic()
                self._tell()
            self._evaluate()
        except KeyboardInterrupt:
            self._save()
            if self._path is not None:
                log.info("interrupted; the same command with the same run folder continues from %s", self._path)
            raise
        finally:
            torch.set_float32_matmul_precision(before)
        self._sac.load_weights(self._best, self._path or Path(CHECKPOINT))
        self._save(finished=True)
        count = self._count
        count.seconds = spent + time.monotonic() - begun
        return LearnReport(
            seconds=count.seconds,
            env_steps=count.env_steps,
            updates=self._sac.updates,
            episodes=count.episodes,
            metrics={
                "best_success": count.best_success,
                "first_success": count.first_success,
                "last_success": count.last_success,
                "best_env_steps": float(count.best_env_steps),
                **self._faults(),
            },
        )

    def _faults(self) -> dict[str, float]:
        return {"faults": float(self._count.faults)}

    def _finished(self) -> bool:
        settings, count = self._settings, self._count
        return (settings.seconds is not None and count.seconds >= settings.seconds) or (
            settings.env_steps is not None and count.env_steps >= settings.env_steps
        )

    def _share(self) -> float:
        settings, count = self._settings, self._count
        shares = [0.0]
        if settings.seconds:
            shares.append(count.seconds / settings.seconds)
        if settings.env_steps:
            shares.append(count.env_steps / settings.env_steps)
        return min(max(shares), 1.0)

    def _step(self, observation: TensorDictBase) -> TensorDictBase:
        """Act once in every world, store what may be stored, begin new episodes."""
        sac, task, count = self._sac, self._task, self._count
        state = self._inputs(observation)
        base = self._base(state) if self._base is not None else state[:, :0]
        keep = self._settings.noise_memory
        self._noise = keep * self._noise + (1 - keep * keep) ** 0.5 * sac.noise(len(state))
        learned = sac.explore(state, base, self._noise)
        observation["action"] = sac.total(learned, base)
        after = task.advance(observation)
        self._replay.add(state, learned, after["reward"][:, 0], end_codes(after), base)
        done = after["done"][:, 0]
        if done.any():
            for world in torch.nonzero(done)[:, 0].tolist():
                count.recent.append(bool(after["success"][world]))
                count.episodes += 1
                count.faults += int(after["fault"][world])
                task.begin(world, task.draw(world))
                self._noise[world] = sac.noise(1)[0]
            after = task.observe()
        count.env_steps += len(state)
        count.updates_owed += self._settings.updates_per_step * len(state)
        return after

    def _update(self) -> None:
        count = self._count
        if count.env_steps < self._settings.warm_up_steps or not self._replay.ready(self._sac.settings.steps):
            count.updates_owed = 0.0
            return
        settings = self._settings
        imitation = settings.imitation * max(0.0, 1.0 - self._share() / settings.imitation_until)
        while count.updates_owed >= 1:
            actor = self._sac.updates >= settings.critic_updates
            self._sac.update(self._batch(self._shown), self._shown, imitation, actor)
            count.updates_owed -= 1

    def _batch(self, shown: int) -> Batch:
        """Draw a batch whose first `shown` transitions are demonstrations."""
        settings = self._sac.settings
        parts = []
        if shown and self._demonstrations is not None:
            parts.append(self._demonstrations.sample(shown, settings.steps, settings.gamma, self._generator))
        if shown < settings.batch:
            count = settings.batch - shown
            parts.append(self._replay.sample(count, settings.steps, settings.gamma, self._generator))
        return concatenate(parts)

    def _warm_up(self) -> None:
        """Imitate the demonstrations, then let the critics judge what came of it, before anything is tried.

        Each of the two ends early when a quarter of the seconds of the budget are spent on it.
        """
        settings = self._settings
        if self._demonstrations is None:
            return
        longest = math.inf if settings.seconds is None else settings.seconds / 4
        size = self._sac.settings.batch
        begun = time.monotonic()
        with learning_rate(self._sac.actor_optimizer, IMITATION_LEARNING_RATE):
            for done in range(settings.imitation_updates):
                if time.monotonic() - begun > longest:
                    break
                self._sac.imitate(self._batch(size))
                if done % 100 == 0:
                    self._progress(0.0, f"imitates the demonstrations, {done} of {settings.imitation_updates}")
        begun = time.monotonic()
        for done in range(settings.warm_up_updates):
            if time.monotonic() - begun > longest:
                break
            self._sac.update(self._batch(size), actor=False)
            if done % 100 == 0:
                self._progress(0.0, f"judges the demonstrations, {done} of {settings.warm_up_updates}")

    def _plan_evaluation(self) -> None:
        """Plan the starts of the training-time evaluations, once."""
        worlds = self._task.batch_size[0]
        each = -(-self._settings.evaluation_episodes // worlds)
        for world in range(worlds):
            rng = np.random.default_rng(EVALUATION_SEED + world)
            self._evaluation_starts.append([self._task.draw(world, rng) for _ in range(each)])

    def _evaluate(self) -> None:
        count = self._count
        count.next_evaluation = count.env_steps + self._settings.evaluate_every
        kept = self._task.state_dict()
        worlds = self._task.batch_size[0]
        results = run_episodes(
            self._policy,
            self._task,
            self._settings.evaluation_episodes,
            lambda world, episode: self._evaluation_starts[world][episode // worlds],
        )
        self._task.load_state_dict(kept)
        score, mean_return = results.success_rate, float(results.returns.mean())
        log.info(
            "%d env steps, %d updates, %.0f s: evaluated %.3f (return %.1f, %.0f steps, %s), exploring %.3f, "
            "alpha %.4f",
            count.env_steps, self._sac.updates, count.seconds, score, mean_return, results.steps.mean(),
            results.ends(),
            np.mean(count.recent) if count.recent else float("nan"), float(self._sac.log_alpha.detach().exp()),
        )  # fmt: skip
        count.last_success = score
        if count.first_success < 0:
            count.first_success = score
        frozen = self._sac.updates <= self._settings.critic_updates  # the same actor, better critics
        if frozen or (score, mean_return) > (count.best_success, count.best_return):
            count.best_success, count.best_return = score, mean_return
            count.best_env_steps = count.env_steps
            self._best = {name: value.clone() for name, value in self._sac.weights().items()}
            if self._exports is not None and isinstance(self._policy, HasWeights):
                self._policy.save(self._exports)

    def _tell(self) -> None:
        count = self._count
        grasped = f"{np.mean(count.recent):.2f}" if count.recent else "-"
        self._progress(
            self._share(),
            f"{count.env_steps} steps, {self._sac.updates} updates, exploring {grasped}, best {count.best_success:.2f}",
        )

    def _save(self, finished: bool = False) -> None:
        """Write everything that decides the future; a failure is logged, training continues."""
        if self._path is None:
            return
        tensors = {f"sac.{k}": v for k, v in self._sac.state_dict().items()}
        tensors.update({f"best.{k}": v for k, v in self._best.items()})
        tensors.update({f"replay.{k}": v for k, v in self._replay.state_dict().items()})
        if self._demonstrations is not None:
            tensors.update({f"demonstrations.{k}": v for k, v in self._demonstrations.state_dict().items()})
        tensors.update({f"task.{k}": v for k, v in self._task.state_dict().items()})
        tensors["generator"], tensors["noise"] = self._generator.get_state(), self._noise
        count = self._count
        header = {
            "finished": finished,
            "version": CHECKPOINT_VERSION,
            "count": {**{k: v for k, v in vars(count).items() if k != "recent"}, "recent": list(count.recent)},
        }
        try:
            write_tensors(self._path, tensors, header)
        except CheckpointError as error:
            log.warning("%s; training continues", error)

    def resume(self) -> bool:
        """Continue from an unfinished checkpoint in the run folder, if there is one."""
        if self._path is None or not self._path.exists():
            return False
        tensors, header = read_tensors(self._path)
        if header["finished"]:
            return False
        if header.get("version") != CHECKPOINT_VERSION:
            raise CheckpointError(
                f"{self._path} is a checkpoint of another version of icub-kit (format {header.get('version', 1)}, this "
                f"one reads {CHECKPOINT_VERSION}); finish it there, or delete it to learn anew"
            )
        self._sac.load_state_dict(part(tensors, "sac"), self._path)
        self._best = part(tensors, "best")
        self._replay.load_state_dict(part(tensors, "replay"))
        if self._demonstrations is not None:
            self._demonstrations.load_state_dict(part(tensors, "demonstrations"))
        self._task.load_state_dict(part(tensors, "task"))
        self._generator.set_state(tensors["generator"])
        self._noise = tensors["noise"]
        kept = header["count"]
        recent = deque(kept.pop("recent"), maxlen=RECENT_EPISODES)
        self._count = _Count(**kept, recent=recent)
        self._resumed = True
        log.info("continuing from %s after %d env steps", self._path, self._count.env_steps)
        return True


@contextlib.contextmanager
def learning_rate(optimizer: torch.optim.Optimizer, rate: float) -> Iterator[None]:
    """Use another learning rate for a while."""
    before = [group["lr"] for group in optimizer.param_groups]
    for group in optimizer.param_groups:
        group["lr"] = rate
    try:
        yield
    finally:
        for group, old in zip(optimizer.param_groups, before, strict=True):
            group["lr"] = old


def end_codes(after: TensorDictBase) -> torch.Tensor:
    """Return the replay codes (N,) of one step: truncations and faults are cut, they are never learned from."""
    codes = torch.full((len(after["done"]),), RUNNING, dtype=torch.uint8)
    codes[after["terminated"][:, 0]] = TERMINAL
    codes[(after["truncated"] | after["fault"])[:, 0]] = CUT
    return codes


def demonstrate(
    task: Task, teacher: Policy, inputs: Inputs, replay: Replay, episodes: int, progress: Progress | None = None
) -> tuple[int, int]:
    """Fill `replay` with whole batch steps of a scripted policy until `episodes` have ended (thesis algorithm 4).

    The teacher sees the privileged observation. Failed episodes are kept, as in the thesis.

    Returns:
        Successes and episodes.
    """
    teacher.bind(task)
    task.reset()
    observation = task.privileged()
    wins = ended = 0
    while ended < episodes and replay.added < len(replay.state):
        state = inputs(observation)
        observation["action"] = teacher.act(observation)
        after = task.advance(observation)
        replay.add(state, observation["action"], after["reward"][:, 0], end_codes(after))
        done = after["done"][:, 0]
        if done.any():
            wins += int(after["success"].sum())
            ended += int(done.sum())
            for world in torch.nonzero(done)[:, 0].tolist():
                task.begin(world, task.draw(world))
            if progress is not None:
                progress(min(ended / episodes, 1.0), f"demonstrations: {wins} of {ended} grasped")
        observation = task.privileged()
    return wins, ended
