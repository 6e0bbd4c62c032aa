"""Events of a run, and who listens to them.

A listener is any object with methods marked by `listen`; it is announced by an entry point of the group ``icub.hooks``
(a class is instantiated without arguments) or passed to `Events`. It takes those arguments of an event that it names::

    from icub_core.hooks import listen

    class Printer:
        @listen
        def icub_episode_end(self, episode, success):
            logging.info("episode %d: %s", episode, success)

Nothing in the core depends on a listener. One that raises is reported once and removed, and the run continues; a
listener that wants to stop a run raises an `IcubError`.
"""

from __future__ import annotations

import inspect
import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import entry_points
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import pluggy

from icub_core.errors import IcubError, PluginError, suggestion

if TYPE_CHECKING:
    import torch
    from tensordict import TensorDictBase

    from icub_core.data import Grasp

PROJECT = "icub"
ENTRY_POINT_GROUP = "icub.hooks"

logger = logging.getLogger(__name__)

listen = pluggy.HookimplMarker(PROJECT)
"""Marks a method as a listener to the event of its name."""

_event = pluggy.HookspecMarker(PROJECT)


class EventSpecs:
    """Every event, when it happens and what it carries."""

    @_event
    def icub_run_start(self, config: Mapping[str, Any], run_dir: Path) -> None:
        """A run begins; `config` is resolved and plain."""

    @_event
    def icub_run_end(self, run: Any, metrics: Mapping[str, float], run_dir: Path, error: BaseException | None) -> None:
        """A run is over; `run` is its `icub_core.run.Run`, `error` None or what ended it (also KeyboardInterrupt)."""

    @_event
    def icub_stage_start(self, stage: str) -> None:
        """A stage, such as ``teach``, begins."""

    @_event
    def icub_stage_end(self, stage: str, seconds: float) -> None:
        """A stage is over, also when an error ended it."""

    @_event
    def icub_progress(self, stage: str, fraction: float, text: str) -> None:
        """A stage has come to `fraction` (0..1)."""

    @_event
    def icub_metrics(self, metrics: Mapping[str, float]) -> None:
        """Figures became known, by their keys in metrics.json."""

    @_event
    def icub_grasp_selected(self, grasp: Grasp) -> None:
        """A planned grasp was chosen to be executed."""

    @_event
    def icub_episode_start(self, episode: int, seed: int) -> None:
        """An episode of the grasping task begins."""

    @_event
    def icub_episode_end(self, episode: int, success: bool, steps: int, reason: str) -> None:
        """An episode is over; `reason` says which termination or fault."""

    @_event
    def icub_step(self, observation: TensorDictBase, action: torch.Tensor, reward: float) -> None:
        """One control step was taken."""


EVENTS: dict[str, tuple[str, ...]] = {
    name: tuple(inspect.signature(method).parameters)[1:]
    for name, method in vars(EventSpecs).items()
    if name.startswith("icub_")
}
"""Event to the names of its arguments."""


class Events:
    """Tells listeners what happens.

    events = Events.discover()
    with events.stage("teach"):
        events.emit("icub_progress", stage="teach", fraction=0.5, text="sugar box")
    if events.wants("icub_step"):  # keep the hot loop free when nobody listens
        events.emit("icub_step", observation=o, action=a, reward=r)
    """

    def __init__(self, listeners: Iterable[object] = ()) -> None:
        """Register listeners; raises PluginError for one that listens to an event that does not exist."""
        self._manager = pluggy.PluginManager(PROJECT)
        self._manager.add_hookspecs(EventSpecs)
        for listener in listeners:
            self.add(listener)

    @classmethod
    def discover(cls, listeners: Iterable[object] = ()) -> Events:
        """Register `listeners` and every installed one; an installed one that is broken is reported and left out."""
        events = cls(listeners)
        for entry in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda e: e.name):
            try:
                target = entry.load()
                events.add(target() if isinstance(target, type) else target, entry.name)
            except (Exception, SystemExit) as cause:
                owner = entry.dist.name if entry.dist else "an unknown distribution"
                logger.warning("the listener '%s' (%s, from %s) is left out: %s", entry.name, entry.value, owner, cause)
        return events

    def add(self, listener: object, name: str | None = None) -> None:
        """Register one listener; raises PluginError, and registers nothing, when it names no event or argument."""
        try:
            self._manager.register(listener, name)
            self._manager.check_pending()
        except (pluggy.PluginValidationError, ValueError) as cause:
            if self._manager.is_registered(listener):
                self._manager.unregister(listener)
            raise PluginError(_explain(listener, str(cause))) from cause
        heard = self._manager.get_hookcallers(listener) or []
        if not heard:
            self._manager.unregister(listener)
            name = type(listener).__name__
            raise PluginError(f"the listener {name} listens to nothing; mark its methods with icub_core.hooks.listen")

    def wants(self, event: str) -> bool:
        """Return True if anybody listens to `event`."""
        return bool(getattr(self._manager.hook, event).get_hookimpls())

    def emit(self, event: str, **arguments: Any) -> None:
        """Tell every listener; raises PluginError for an event or argument that does not exist."""
        expected = EVENTS.get(event)
        if expected is None:
            raise PluginError(f"there is no event '{event}'.{suggestion(event, EVENTS)} Known: {', '.join(EVENTS)}")
        if set(arguments) != set(expected):
            raise PluginError(
                f"event {event} was given {', '.join(arguments) or 'nothing'}; expected {', '.join(expected)}"
            )
        # pluggy's own call ends at the first exception, so one broken listener would silence all others
        for implementation in reversed(getattr(self._manager.hook, event).get_hookimpls()):
            try:
                implementation.function(*(arguments[name] for name in implementation.argnames))
            except IcubError:
                raise
            except Exception:
                name = type(implementation.plugin).__name__
                logger.warning("the listener %s failed at %s and is removed", name, event, exc_info=True)
                self._manager.unregister(implementation.plugin)

    @contextmanager
    def stage(self, name: str) -> Iterator[Callable[[float, str], None]]:
        """Emit start and end around a stage; gives a callback ``progress(fraction, text)``."""
        self.emit("icub_stage_start", stage=name)
        start = perf_counter()
        try:
            yield lambda fraction, text: self.emit("icub_progress", stage=name, fraction=fraction, text=text)
        finally:
            self.emit("icub_stage_end", stage=name, seconds=perf_counter() - start)


def _explain(listener: object, cause: str) -> str:
    """Name the nearest event or argument for a misspelt one; pluggy's own message for anything else."""
    name = type(listener).__name__
    for attribute in dir(type(listener)):
        method: Any = getattr(listener, attribute, None)
        if not hasattr(method, f"{PROJECT}_impl"):
            continue
        if attribute not in EVENTS:
            known = ", ".join(EVENTS)
            return f"{name} listens to '{attribute}', which is no event.{suggestion(attribute, EVENTS)} Known: {known}"
        for argument in inspect.signature(method).parameters:
            if argument not in EVENTS[attribute]:
                known = ", ".join(EVENTS[attribute])
                hint = suggestion(argument, EVENTS[attribute])
                return f"{name}.{attribute} asks for '{argument}', which the event has not.{hint} Known: {known}"
    return " ".join(cause.split())
