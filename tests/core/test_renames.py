"""Old names of parameters: accepted with a warning in Python, in configurations and on the command line."""

import pytest

from icub_core.config.compose import compose
from icub_core.construct import build
from icub_core.errors import ConfigError
from icub_core.renames import renamed


@renamed(lam="penalty")
class Ridge:
    def __init__(self, penalty: float = 1.0) -> None:
        self.penalty = penalty


class Child(Ridge):
    def __init__(self, lam: float = 3.0) -> None:
        super().__init__(penalty=lam)


def test_the_constructor_takes_old_names_with_a_warning():
    with pytest.warns(DeprecationWarning, match="'lam' of Ridge is now called 'penalty'"):
        assert Ridge(lam=2.0).penalty == 2.0
    assert Ridge(2.5).penalty == 2.5
    with pytest.raises(ConfigError, match="expected only one of them"):
        Ridge(lam=2.0, penalty=1.0)
    assert Child(lam=4.0).penalty == 4.0  # a constructor of its own has its own names


def test_configurations_take_old_names_with_a_warning():
    with pytest.warns(DeprecationWarning, match="now called 'n_centers'"):
        assert build("online_head", {"plugin": "falkon", "centers": 7}).n_centers == 7
    with pytest.warns(DeprecationWarning, match="now called 'penalty'"):
        config = compose(["online_head=falkon", "online_head.lam=0.5", "~simulator", "~robot", "~objects"])
    assert config.online_head.penalty == 0.5
    assert "lam" not in config.online_head


def test_yaml_files_take_old_names_with_a_warning(tmp_path):
    (tmp_path / "experiment").mkdir()
    (tmp_path / "online_head").mkdir()
    (tmp_path / "online_head" / "mine.yaml").write_text("plugin: falkon\nlam: 0.25\n")
    words = ["online_head=mine", "~simulator", "~robot", "~objects"]
    with pytest.warns(DeprecationWarning, match="now called 'penalty'"):
        config = compose(words, config_dir=tmp_path)
    assert build("online_head", config.online_head).penalty == 0.25
