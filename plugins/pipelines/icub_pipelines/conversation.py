"""The interactive mode of teaching by showing: commands from a terminal, answers in a few lines."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.table import Table

from icub_core.errors import ConfigError, IcubError, unknown_name
from icub_core.interfaces.object_set import ObjectSet
from icub_core.scene import ObjectSpec
from icub_pipelines.images import draw_instances, save_image
from icub_pipelines.tabletop import Tabletop
from icub_pipelines.teaching_session import TeachingSession, identities

HELP = """\
teach NAME        show an object and learn it
look [NAME ...]   put objects on the table and say what is seen; without names, some known and some unknown ones
known             objects learned so far
objects           objects that can be shown
save              write what was learned into the run folder
quit              save and leave (so does the end of the input)"""
PROMPT = "icub> "
STAGE = "converse"
"""Stage of a run in which the terminal is the user's."""


def converse(
    session: TeachingSession,
    objects: ObjectSet,
    unknown: Sequence[ObjectSpec],
    frames: int,
    ask: Callable[[str], str] = input,
) -> None:
    """Answer commands until ``quit`` or the end of the input; a wrong command gets one line and changes nothing.

    Args:
        session: Who teaches and learns.
        objects: What can be shown, besides `unknown`.
        unknown: Objects that stand about and can be taught, too.
        frames: Images of an object that is taught.
        ask: Returns what was typed after a prompt; raises EOFError at the end of the input.
    """
    _Conversation(session, objects, unknown, frames).answer_all(ask)


class _Conversation:
    def __init__(
        self, session: TeachingSession, objects: ObjectSet, unknown: Sequence[ObjectSpec], frames: int
    ) -> None:
        self._session, self._frames = session, frames
        self._specs = {name: objects.get(name) for name in objects.names} | {spec.name: spec for spec in unknown}
        self._console = Console()
        self._looks = 0
        self._training_images = 0
        self._commands = {
            "teach": self._teach, "look": self._look, "known": self._known, "objects": self._objects,
            "save": self._save, "help": self._help,
        }  # fmt: skip

    def answer_all(self, ask: Callable[[str], str]) -> None:
        if self._session.heads.is_dir():
            self._session.segmenter.load(self._session.heads)
            self._console.print(f"resuming from what was learned in {self._session.heads}", soft_wrap=True)
        self._console.print("type help for the commands")
        while True:
            try:
                words = ask(PROMPT).split()
            except EOFError:
                words = ["quit"]
            if words and words[0] in ("quit", "exit"):
                break
            if words:
                try:
                    self._answer(*words)
                except IcubError as error:
                    self._console.print(str(error), soft_wrap=True, markup=False)
        self._save()
        self._session.run.record(
            {"showing.objects": len(self._session.segmenter.classes), "showing.lessons": self._training_images}
        )

    def _answer(self, command: str, *words: str) -> None:
        if command not in self._commands:
            raise ConfigError(unknown_name("command", command, [*self._commands, "quit"]))
        if words and command not in ("teach", "look"):
            raise ConfigError(f"{command} takes no names; got {' '.join(words)}")
        self._commands[command](*words)

    @contextmanager
    def _stage(self, name: str) -> Iterator[None]:
        run = self._session.run
        run.stage = name
        with run.events.stage(name):
            yield

    def _spec(self, name: str) -> ObjectSpec:
        if name not in self._specs:
            raise ConfigError(unknown_name("object", name, list(self._specs)))
        return self._specs[name]

    def _teach(self, *names: str) -> None:
        if len(names) != 1:
            raise ConfigError("teach needs the name of one object, such as: teach 004_sugar_box")
        run = self._session.run
        spec = self._spec(names[0])
        self._training_images += 1
        with self._stage("teach"):
            rng = run.rng(f"teach {len(self._session.segmenter.classes)} {self._training_images}")
            report, sample, seconds = self._session.teach(spec, self._frames, rng)
        image = run.run_dir / f"taught_{self._training_images:02d}.png"
        save_image(image, sample)
        self._session.segmenter.save(self._session.heads)
        self._console.print(
            f"learned {spec.name}: {seconds:.1f} s in all, {report.seconds:.1f} s after the last frame; {image}",
            soft_wrap=True,
        )

    def _look(self, *names: str) -> None:
        segmenter, run = self._session.segmenter, self._session.run
        if not segmenter.classes:
            raise ConfigError("nothing is known yet; expected: teach NAME first")
        self._looks += 1
        wanted = [self._spec(name) for name in names]
        known = [self._specs[name] for name in segmenter.classes if name in self._specs]
        if wanted:
            known, other = wanted, []
            tabletop = Tabletop(frames=1, targets=(len(wanted), len(wanted)))
        else:
            other, tabletop = [s for s in self._specs.values() if s.name not in segmenter.classes], Tabletop(frames=1)
        with self._stage("look"):
            looks = self._session.look(known, other, tabletop, run.rng(f"look {self._looks}"))
            (found,) = self._session.recognize(looks)
        frame, truth = looks[0]
        table = Table("seen as", "score", "in truth")
        shown = identities(found, truth)
        for instance, name in shown:
            table.add_row(instance.label, f"{instance.score:.2f}", name or "no single object")
        image = run.run_dir / f"look_{self._looks:02d}.png"
        save_image(image, draw_instances(frame.rgb, [instance for instance, _ in shown]))
        self._console.print(table)
        self._console.print(f"on the table: {', '.join(t.label for t in truth)}; {image}", soft_wrap=True)

    def _known(self) -> None:
        self._console.print(", ".join(self._session.segmenter.classes) or "nothing yet", soft_wrap=True)

    def _objects(self) -> None:
        self._console.print(", ".join(self._specs), soft_wrap=True)

    def _save(self) -> None:
        if self._session.segmenter.classes:
            self._session.segmenter.save(self._session.heads)
            self._console.print(f"saved in {self._session.heads}", soft_wrap=True)

    def _help(self) -> None:
        self._console.print(HELP, markup=False)
