"""``icub run``: compose a run and carry it out in its own folder."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from icub_core.cli import Interrupted
from icub_core.errors import ConfigError

if TYPE_CHECKING:
    from omegaconf import DictConfig

HELP = """\
usage: icub run [--resume FOLDER] [-m] [--cfg job] [GROUP=NAME ...] [KEY=VALUE ...]

Compose a robot, its senses and its skills, and run them. The main job is
  icub run +segmenter=NAME +policy=NAME

GROUP=NAME, +GROUP=NAME   choose a plugin or a preset
~GROUP, GROUP=null        leave a plugin out; without a segmenter, ground-truth masks are used
GROUP.PARAMETER=VALUE     set a parameter; icub plugins show NAME lists them
KEY=VALUE                 set a value of the run
--resume FOLDER           resume an interrupted run
-m, --multirun            run every combination of comma-separated values
--cfg job                 print the composed configuration and stop
--config-dir FOLDER       search one more folder for configurations

"""

OVERRIDES_FILE = Path(".hydra", "overrides.yaml")

_current: dict[str, Path] = {}
"""Folder of the run that is under way in this process, for the message after Ctrl-C."""


def main(arguments: Sequence[str]) -> int:
    """Compose a robot, its senses and its skills, and run them.

    Raises:
        IcubError: What went wrong, in one line.
        Interrupted: After Ctrl-C, with the command that resumes the run.
    """
    words = list(arguments)
    if "--help" in words or "-h" in words:
        from icub_core.config.compose import vocabulary

        groups, settings = vocabulary()
        lines = [f"  {group}: {', '.join(options)}" for group, options in groups.items()]
        sys.stdout.write(HELP + "groups:\n" + "\n".join(lines) + f"\nsettings: {', '.join(settings)}\n")
        return 0
    return _run(_resumed(words))


def _run(words: list[str]) -> int:
    flags = [word for word in words if word.startswith("-") and not word.startswith(("--config-dir", "-cd"))]
    _current.clear()
    try:
        return _with_hydra(words) if flags else _once(words)
    except KeyboardInterrupt:
        if "run_dir" not in _current:
            raise
        raise Interrupted(f"icub: interrupted; to resume: icub run --resume {_current['run_dir']}") from None


def _once(words: list[str]) -> int:
    """Compose once, check once, and carry out in a run folder laid out as Hydra's own."""
    from hydra.core.hydra_config import HydraConfig
    from hydra.core.utils import configure_log
    from omegaconf import OmegaConf, open_dict

    from icub_core.config.compose import compose, one_line_errors
    from icub_core.config.settings import check_device
    from icub_core.files import write_text_atomically

    overrides = _overrides(words)
    config = compose(overrides, _config_dir(words), with_hydra=True)
    check_device(config)  # before a run folder exists
    with one_line_errors():
        run_dir = Path(config.hydra.run.dir).absolute()
        config.hydra.runtime.output_dir = str(run_dir)
        HydraConfig.instance().set_config(config)
        hydra_node = OmegaConf.masked_copy(config, "hydra")
        with open_dict(config):
            del config["hydra"]
        run_dir.mkdir(parents=True, exist_ok=True)
        configure_log(hydra_node.hydra.job_logging, hydra_node.hydra.verbose)
    write_text_atomically(run_dir / OVERRIDES_FILE, OmegaConf.to_yaml(OmegaConf.create(overrides)))
    write_text_atomically(run_dir / ".hydra" / "config.yaml", OmegaConf.to_yaml(config))
    _carry_out(config, run_dir)
    return 0


def _with_hydra(words: list[str]) -> int:
    """Let Hydra's own application serve sweeps and questions about the configuration."""
    from icub_core.config.compose import PRIMARY, VERSION_BASE, one_line_errors, vocabulary
    from icub_core.config.folders import config_folders
    from icub_core.config.overrides import rewrite
    from icub_core.config.sources import register

    rewritten = rewrite(words, *vocabulary(_config_dir(words)))
    register()
    import hydra

    os.environ["HYDRA_FULL_ERROR"] = "1"  # exceptions reach us instead of being printed by Hydra
    typed, sys.argv = sys.argv, ["icub run", *rewritten]
    try:
        with one_line_errors():
            hydra.main(version_base=VERSION_BASE, config_path=str(config_folders()[0]), config_name=PRIMARY)(job)()
    finally:
        sys.argv = typed
    return 0


def job(config: DictConfig) -> dict[str, Any]:
    """Carry out one run of a sweep; returns its metrics, so that sweepers can optimize them."""
    from hydra.core.hydra_config import HydraConfig

    from icub_core.config.compose import check
    from icub_core.config.settings import check_device

    check(config)
    check_device(config)
    return _carry_out(config, Path(HydraConfig.get().runtime.output_dir))


def _carry_out(config: DictConfig, run_dir: Path) -> dict[str, Any]:
    from omegaconf import OmegaConf

    from icub_core.files import write_text_atomically
    from icub_core.runner import carry_out

    _current["run_dir"] = _relative(run_dir)
    config.run_dir = str(run_dir)
    write_text_atomically(run_dir / "config.yaml", OmegaConf.to_yaml(config, resolve=True))
    return carry_out(config, run_dir)


def _resumed(words: list[str]) -> list[str]:
    """Replace ``--resume FOLDER`` by what was typed for that run, followed by what is typed now."""
    if "--resume" not in words:
        return words
    position = words.index("--resume")
    if position + 1 == len(words):
        raise ConfigError("--resume needs the folder of a run, such as runs/2026-01-31/12-00-00")
    folder = Path(words[position + 1])
    record = folder / OVERRIDES_FILE
    if not record.is_file():
        raise ConfigError(f"{folder} is not the folder of a run: {record} does not exist")
    _check_version(folder)
    import yaml

    earlier = [str(word) for word in yaml.safe_load(record.read_text(encoding="utf-8")) or []]
    earlier = [word for word in earlier if not word.startswith("run_dir=")]
    return [*earlier, *words[:position], *words[position + 2 :], f"run_dir={folder}"]


def _check_version(folder: Path) -> None:
    """Refuse the folder of a run that another version of the project has begun; raises ConfigError."""
    from icub_core import __version__
    from icub_core.provenance import OWN

    try:
        begun = str(json.loads((folder / "provenance.json").read_text(encoding="utf-8"))["versions"][OWN])
    except (OSError, ValueError, KeyError, TypeError):
        return  # interrupted before anything was written: there is nothing to misread
    if begun.split(".")[:2] != __version__.split(".")[:2]:
        raise ConfigError(
            f"{folder} was begun by {OWN} {begun}, this is {__version__}; finish it there, or start a new run"
        )


def _overrides(words: list[str]) -> list[str]:
    """Return the words that are neither flags nor values of flags."""
    from icub_core.config.overrides import FLAGS_WITH_VALUE

    return [
        word
        for previous, word in zip(["", *words], words, strict=False)
        if not word.startswith("-") and previous not in FLAGS_WITH_VALUE
    ]


def _config_dir(words: list[str]) -> Path | None:
    for previous, word in zip(["", *words], words, strict=False):
        folder = word.partition("=")[2] if word.startswith("--config-dir=") else word
        if previous in ("--config-dir", "-cd") or word.startswith("--config-dir="):
            if not Path(folder).is_dir():
                raise ConfigError(f"the configuration folder '{folder}' does not exist")
            return Path(folder)
    return None


def _relative(folder: Path) -> Path:
    return folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else folder
