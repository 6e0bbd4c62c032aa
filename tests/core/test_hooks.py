"""Events reach their listeners; a broken listener is removed and the run goes on."""

import logging

import pytest

from icub_core.errors import IcubError, PluginError
from icub_core.hooks import EVENTS, Events, listen


class Recorder:
    def __init__(self):
        self.heard = []

    @listen
    def icub_stage_start(self, stage):
        self.heard.append(("start", stage))

    @listen
    def icub_progress(self, fraction, stage):
        self.heard.append((stage, fraction))

    @listen
    def icub_stage_end(self, stage, seconds):
        self.heard.append(("end", stage, seconds >= 0))


class Raises:
    def __init__(self, error):
        self.error = error

    @listen
    def icub_progress(self):
        raise self.error


def test_a_stage_is_told_with_its_progress():
    recorder = Recorder()
    with Events([recorder]).stage("teach") as progress:
        progress(0.5, "half")
    assert recorder.heard == [("start", "teach"), ("teach", 0.5), ("end", "teach", True)]


def test_the_end_of_a_stage_is_told_also_after_an_error():
    recorder = Recorder()
    with pytest.raises(KeyError), Events([recorder]).stage("teach"):
        raise KeyError
    assert recorder.heard[-1] == ("end", "teach", True)


def test_a_listener_that_raises_is_removed_and_the_others_hear_on(caplog):
    before, after = Recorder(), Recorder()
    events = Events([before, Raises(ZeroDivisionError()), after])
    with caplog.at_level(logging.WARNING), events.stage("see") as progress:
        progress(0.1, "")
        progress(0.2, "")
    assert before.heard == after.heard
    assert len(before.heard) == 4
    assert caplog.text.count("the listener Raises failed at icub_progress and is removed") == 1


def test_a_listener_may_stop_a_run_on_purpose():
    with pytest.raises(IcubError, match="too hot"):
        Events([Raises(IcubError("too hot"))]).emit("icub_progress", stage="x", fraction=0.0, text="")


def test_nobody_listening_costs_nothing():
    events = Events([Recorder()])
    assert not events.wants("icub_step")
    assert events.wants("icub_progress")


class MisspeltEvent:
    @listen
    def icub_episode_ned(self, episode): ...


class MisspeltArgument:
    @listen
    def icub_progress(self, frction): ...


class Deaf:
    def icub_progress(self, fraction): ...


@pytest.mark.parametrize(
    ("listener", "message"),
    [
        (MisspeltEvent(), "listens to 'icub_episode_ned', which is no event. Did you mean 'icub_episode_end'?"),
        (MisspeltArgument(), "asks for 'frction', which the event has not. Did you mean 'fraction'?"),
        (Deaf(), "the listener Deaf listens to nothing"),
    ],
)
def test_a_listener_that_would_never_hear_is_refused(listener, message):
    events = Events()
    with pytest.raises(PluginError) as caught:
        events.add(listener)
    assert message in str(caught.value)
    assert not events.wants("icub_progress")


def test_emitting_what_does_not_exist_is_refused():
    with pytest.raises(PluginError, match="there is no event 'icub_stage_strt'. Did you mean 'icub_stage_start'?"):
        Events().emit("icub_stage_strt", stage="x")
    with pytest.raises(PluginError, match="event icub_stage_start was given stag; expected stage"):
        Events().emit("icub_stage_start", stag="x")


def test_installed_listeners_are_found_and_broken_ones_left_out(install, caplog):
    install(
        "listening",
        {
            "icub.hooks": {
                "good": "listening_module:Good",
                "module": "listening_functions",
                "broken": "no_such_module:Listener",
                "misspelt": "listening_module:Misspelt",
            }
        },
        {
            "listening_module.py": """
from icub_core.hooks import listen
heard = []
class Good:
    @listen
    def icub_metrics(self, metrics): heard.append(dict(metrics))
class Misspelt:
    @listen
    def icub_metric(self, metrics): ...
""",
            "listening_functions.py": """
from icub_core.hooks import listen
from listening_module import heard
@listen
def icub_metrics(metrics): heard.append("function")
""",
        },
    )
    with caplog.at_level(logging.WARNING):
        events = Events.discover()
    events.emit("icub_metrics", metrics={"a": 1.0})
    import listening_module

    assert listening_module.heard == ["function", {"a": 1.0}] or listening_module.heard == [{"a": 1.0}, "function"]
    assert "the listener 'broken' (no_such_module:Listener, from listening) is left out" in caplog.text
    assert "Did you mean 'icub_metrics'?" in caplog.text


def test_every_event_is_documented():
    from icub_core.hooks import EventSpecs

    assert all(getattr(EventSpecs, name).__doc__ for name in EVENTS)
