"""What is typed after `icub run` means what a person expects, and misspellings stop with a suggestion."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from icub_core.config.overrides import rewrite
from icub_core.errors import ConfigError

GROUPS = {
    "segmenter": ("falkon", "other"),
    "online_head": ("falkon", "rls"),
    "policy": ("gpayn", "resprect"),
    "experiment": ("quick",),
    "scene": ("tabletop",),
}
SETTINGS = ("seed", "device", "run_dir")


def _rewrite(*words):
    return rewrite(words, GROUPS, SETTINGS)


@pytest.mark.parametrize(
    ("typed", "becomes"),
    [
        ("segmenter=falkon", "segmenter=falkon"),
        ("+segmenter=falkon", "segmenter=falkon"),
        ("++segmenter=falkon", "segmenter=falkon"),
        ("~segmenter", "segmenter=none"),
        ("~segmenter=falkon", "segmenter=none"),
        ("segmenter=null", "segmenter=none"),
        ("segmenter=falkon,other", "segmenter=falkon,other"),
        ("policy=resprect,null", "policy=resprect,none"),
        ("+segmenter=glob(*)", "segmenter=glob(*)"),
        ("+experiment=quick", "experiment=quick"),
        ("~experiment", "~experiment"),
        ("seed=3", "seed=3"),
        ("+seed=3", "seed=3"),
        ("seed=range(1,4)", "seed=range(1,4)"),
        ("policy.lr=1e-3", "policy.lr=1e-3"),
        ("+policy.lr=1e-3", "policy.lr=1e-3"),
        ("+policy.table.key=1", "+policy.table.key=1"),
        ("hydra/launcher=joblib", "hydra/launcher=joblib"),
        ("+hydra.job.num=3", "+hydra.job.num=3"),
        ("run_dir=a/b=c", "run_dir=a/b=c"),
    ],
)
def test_overrides_become_what_hydra_takes(typed, becomes):
    assert _rewrite(typed) == [becomes]


def test_flags_and_their_values_pass_through():
    words = ["-m", "--cfg", "job", "--config-dir", "some/folder", "+policy=gpayn", "--info", "searchpath"]
    assert _rewrite(*words) == [word.removeprefix("+") for word in words]


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("+segmentr=falkon", "there is no plugin kind or setting named 'segmentr'. Did you mean 'segmenter=falkon'?"),
        ("segmentr=falkon", "Did you mean 'segmenter=falkon'?"),
        ("~segmentr", "Did you mean 'segmenter'?"),
        ("polcy.lr=3", "Did you mean 'policy.lr=3'?"),
        ("sead=3", "Did you mean 'seed=3'?"),
        ("segmenter=falcon", "no segmenter plugin named 'falcon'. Did you mean 'falkon'?"),
        ("segmenter=falkon,othr", "no segmenter plugin named 'othr'. Did you mean 'other'?"),
        ("experiment=quik", "no experiment configuration named 'quik'. Did you mean 'quick'?"),
        ("resprect", "'resprect' is not KEY=VALUE. Did you mean 'policy=resprect'?"),
        ("falkon", "Did you mean 'segmenter=falkon' or 'online_head=falkon'?"),
        ("what is this", "is not KEY=VALUE"),
    ],
)
def test_misspellings_stop_with_a_suggestion(typed, message):
    with pytest.raises(ConfigError) as caught:
        _rewrite(typed)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@settings(deadline=None)
@given(
    st.lists(
        st.sampled_from(["segmenter", "policy", "online_head"]).flatmap(
            lambda group: st.tuples(st.sampled_from(["", "+", "++"]), st.just(group), st.sampled_from(GROUPS[group]))
        )
    )
)
def test_the_sign_in_front_of_a_choice_never_matters(choices):
    signed = [f"{sign}{group}={name}" for sign, group, name in choices]
    plain = [f"{group}={name}" for _, group, name in choices]
    assert _rewrite(*signed) == _rewrite(*plain) == plain


@settings(deadline=None)
@given(st.text(max_size=20))
def test_any_word_is_either_taken_or_refused_in_one_line(word):
    try:
        taken = _rewrite(word)
    except ConfigError as error:
        taken, message = [], str(error)
    assert len(taken) == 1 or "is not KEY=VALUE" in message or "named" in message
