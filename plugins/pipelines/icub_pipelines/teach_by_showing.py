"""Teaching by showing (thesis 11.8): objects one after another, then a false positive is found, taught, and gone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np

from icub_core.bounds import at_least
from icub_core.data import Instance
from icub_core.errors import ConfigError
from icub_core.interfaces.pipeline import Pipeline, Stage
from icub_core.renames import renamed
from icub_core.run import Run
from icub_core.scene import ObjectSpec
from icub_pipelines import seeing
from icub_pipelines.conversation import converse
from icub_pipelines.images import draw_instances
from icub_pipelines.settings import SeeSettings, taught_names
from icub_pipelines.tabletop import Tabletop
from icub_pipelines.teaching_session import Look, Mistake, TeachingSession, mistakes, recognized
from icub_support.detection import evaluate_instances

TAUGHT = 3
"""Objects that are taught when nothing was chosen."""
NEIGHBORS = 3
"""Other unknown objects beside the corrected one in the images that measure the correction."""


@renamed(strangers="distractors")
class TeachByShowing(Pipeline):
    """Teach objects one after another, then correct a false positive by teaching it; or do so in conversation.

    Args:
        objects: Taught in this order; what is learned of one is there before the next is shown. None teaches the
            first three of `preferred`, or of a set that has not all of them.
        preferred: See `objects`.
        frames: Images of each.
        looks: Images of the table in which false positives are sought, and as many others that measure the change.
        distractors: Unknown objects on the table; one of them is mistaken, and then taught.
        distractor_set: Object set that is in no training set; None takes the rest of the object set alone.
        interactive: Take commands from the terminal instead of following the script.
    """

    def __init__(
        self,
        objects: list[str] | None = None,
        preferred: tuple[str, ...] = (),
        frames: Annotated[int, at_least(1)] = 60,
        looks: Annotated[int, at_least(1)] = 24,
        distractors: Annotated[int, at_least(1)] = 10,
        distractor_set: str | None = None,
        interactive: bool = False,
    ) -> None:
        self._chosen, self._preferred, self._frames, self._looks = objects, preferred, frames, looks
        self._interactive = interactive
        self._see = SeeSettings(distractors=distractors, distractor_set=distractor_set)
        self._distractor: ObjectSpec | None = None

    def stages(self, run: Run) -> tuple[Stage, ...]:
        """Return teach, look, before, correct, after; or converse."""
        if not run.plugins.chosen("segmenter"):
            raise ConfigError("there is nobody to teach; choose +segmenter=falkon")
        objects = run.plugins.get("objects")
        names = taught_names(self._chosen, self._preferred, objects.names, TAUGHT)
        self._taught = [objects.get(name) for name in names]
        if not self._taught:
            raise ConfigError("pipeline.objects is empty; expected at least one name of the object set")
        # the stream keeps its first name, so that figures stay what they were
        self._unknown = seeing.distractors(objects, names, self._see, run.rng("strangers"))
        run.plugins.get("segmenter")
        if self._interactive:
            return (Stage("converse", self._converse),)

        def finished(run: Run) -> bool:
            return (run.run_dir / "done_after.json").exists()  # what stands between is kept in memory alone

        return (
            Stage("teach", self._teach, resume=self._load),
            Stage("look", self._look, resume=finished),
            Stage("before", self._before, resume=finished),
            Stage("correct", self._correct, resume=finished),
            Stage("after", self._after),
        )

    def _session(self, run: Run) -> TeachingSession:
        simulator = run.shared("simulator", lambda: run.plugins.fresh("simulator"))
        return TeachingSession(run, simulator, run.plugins.get("robot").description, run.plugins.get("segmenter"))

    def _load(self, run: Run) -> bool:
        session = self._session(run)
        if not session.heads.exists():
            return False
        session.segmenter.load(session.heads)
        return True

    def _converse(self, run: Run) -> None:
        converse(self._session(run), run.plugins.get("objects"), self._unknown, self._frames)

    def _teach(self, run: Run) -> None:
        session, rng = self._session(run), run.rng("teach")
        taught = [
            session.teach(spec, self._frames, rng, number, len(self._taught))
            for number, spec in enumerate(self._taught)
        ]
        seeing.save_sheet(run, "Taught: masks from depth", "taught.png", [sample for _, sample, _ in taught])
        run.record(
            {
                "showing.objects": len(taught),
                "showing.teach_seconds": float(np.mean([seconds for _, _, seconds in taught])),
                "showing.update_seconds": max(report.seconds for report, _, _ in taught),
            }
        )
        session.segmenter.save(session.heads)

    def _look(self, run: Run) -> None:
        session = self._session(run)
        looks = session.look(self._taught, self._unknown, Tabletop(frames=self._looks), run.rng("look"))
        wrong = [mistake for m in _all_mistakes(session.recognize(looks), looks) for mistake in m]
        self._distractor = _most_mistaken(wrong, self._unknown)
        if self._distractor is None:
            run.note(f"no unknown object was taken for a taught one in {self._looks} images: nothing to correct")
            run.record({"showing.false_positives_before": 0})

    def _before(self, run: Run) -> None:
        """Take images that have no part in choosing what is corrected, and say what is found in them."""
        if self._distractor is None:
            return
        session, name = self._session(run), self._distractor.name
        shown = [self._distractor, *[spec for spec in self._unknown if spec.name != name][:NEIGHBORS]]
        everyone = Tabletop(frames=self._looks, distractors=(len(shown), len(shown)))
        self._measured = session.look(self._taught, shown, everyone, run.rng("measure"))
        self._found_before = session.recognize(self._measured)

    def _correct(self, run: Run) -> None:
        """Teach the mistaken object."""
        if self._distractor is None:
            return
        session = self._session(run)
        self._update, self._sample, _ = session.teach(self._distractor, self._frames, run.rng("correct"))

    def _after(self, run: Run) -> None:
        if self._distractor is None:
            return
        session = self._session(run)
        after = session.recognize(self._measured)
        names = [spec.name for spec in self._taught]
        figures = _figures(self._measured, self._found_before, after, self._distractor.name, names)
        run.record({**figures, "showing.correct_update_seconds": self._update.seconds})
        self._save_sheets(run, after)
        session.segmenter.save(session.heads)

    def _save_sheets(self, run: Run, after: Sequence[tuple[Instance, ...]]) -> None:
        assert self._distractor is not None
        looks, before, name = self._measured, self._found_before, self._distractor.name
        mistaken = _mistakes_of(name, before, looks)
        chosen = sorted(range(len(looks)), key=lambda n: not mistaken[n])[: seeing.SHEET_COLUMNS]
        for caption, file, found in (("Before", "before.png", before), ("After", "after.png", after)):
            images = [draw_instances(looks[n][0].rgb, seeing.confident(found[n])) for n in chosen]
            seeing.save_sheet(run, f"{caption} '{name}' was taught", file, images)
        seeing.save_sheet(run, f"The correction: '{name}' is shown", "correction.png", [self._sample])


def _figures(
    looks: Sequence[Look],
    before: Sequence[tuple[Instance, ...]],
    after: Sequence[tuple[Instance, ...]],
    corrected: str,
    names: Sequence[str],
) -> dict[str, Any]:
    """Return how often the corrected object was mistaken, and how well the others are found, before and after."""
    earlier = [m for image in _mistakes_of(corrected, before, looks) for m in image]
    answers = [recognized(found, truth, corrected) for found, (_, truth) in zip(after, looks, strict=True)]
    visible = [answer for answer in answers if answer is not None]

    def precision(found: Sequence[tuple[Instance, ...]]) -> float:
        pairs = [(_of(names, truth), _of(names, instances)) for instances, (_, truth) in zip(found, looks, strict=True)]
        return evaluate_instances([t for t, _ in pairs], [f for _, f in pairs], names).map50_segm

    return {
        "showing.corrected": corrected,
        "showing.taken_for": Counter(m.taken_for for m in earlier).most_common(1)[0][0] if earlier else "",
        "showing.looks_with_corrected": len(visible),
        "showing.false_positives_before": len(earlier),
        "showing.false_positives_after": sum(map(len, _mistakes_of(corrected, after, looks))),
        "showing.corrected_recall": float(np.mean(visible)) if visible else 0.0,
        "showing.map50_segm_before": precision(before),
        "showing.map50_segm_after": precision(after),
    }


def _mistakes_of(name: str, found: Sequence[tuple[Instance, ...]], looks: Sequence[Look]) -> list[list[Mistake]]:
    return [[m for m in image if m.shown == name] for image in _all_mistakes(found, looks)]


def _of(names: Sequence[str], instances: Sequence[Instance]) -> tuple[Instance, ...]:
    return tuple(instance for instance in instances if instance.label in names)


def _all_mistakes(found: Sequence[tuple[Instance, ...]], looks: Sequence[Look]) -> list[list[Mistake]]:
    return [mistakes(instances, truth) for instances, (_, truth) in zip(found, looks, strict=True)]


def _most_mistaken(wrong: Sequence[Mistake], unknown: Sequence[ObjectSpec]) -> ObjectSpec | None:
    """Return the unknown object that was most often taken for a taught one, the first of equals."""
    counts = Counter(mistake.shown for mistake in wrong)
    candidates = [spec for spec in unknown if counts[spec.name]]
    return max(candidates, key=lambda spec: counts[spec.name]) if candidates else None
