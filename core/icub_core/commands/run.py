"""``icub run``: compose a run and carry it out in its own folder."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from icub_core.cli import Interrupted
from icub_core.errors import ConfigError, IcubError

if TYPE_CHECKING:
    from omegaconf import DictConfig

HELP = """\
usage: icub run [--resume FOLDER] [-m] [--cfg job] [GROUP=NAME ...] [KEY=VALUE ...]

Compose a robot, its senses and its skills, and run them. The main job is
  icub run +segmenter=falkon +policy=resprect

GROUP=NAME, +GROUP=NAME   choose a plugin or a preset
~GROUP, GROUP=null        leave a stage out: the simulator's ground truth takes its place
GROUP.PARAMETER=VALUE     set a parameter; icub plugins show NAME lists them
KEY=VALUE                 set a value of the run
--resume FOLDER           go on with an interrupted run
-m, --multirun            run every combination of comma-separated values
--cfg job                 print the composed configuration and stop
--config-dir FOLDER       search one more folder for configurations

"""

NOT_A_RUN = {"--cfg", "-c", "--info", "-i", "--hydra-help", "--shell-completion", "-sc"}
MULTIRUN = {"-m", "--multirun"}
OVERRIDES_FILE = Path(".hydra", "overrides.yaml")

_current: dict[str, Path] = {}
"""Folder of the run that is under way in this process, for the message after Ctrl-C."""


def main(arguments: Sequence[str]) -> int:
    """Run ``icub run``; returns the exit code.

    Raises:
        IcubError: What went wrong, in one line.
        Interrupted: After Ctrl-C, with the line that goes on.
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
    from icub_core.config.compose import PRIMARY, VERSION_BASE, compose, one_line_errors, vocabulary
    from icub_core.config.folders import config_folders
    from icub_core.config.overrides import rewrite
    from icub_core.config.settings import check_device
    from icub_core.config.sources import register

    config_dir = _config_dir(words)
    rewritten = rewrite(words, *vocabulary(config_dir))
    if not any(word.split("=")[0] in NOT_A_RUN | MULTIRUN for word in words):
        # errors are found here, before a run folder exists; a sweep is checked job by job
        check_device(compose([word for word in _overrides(words) if not word.startswith("hydra")], config_dir))
    register()
    import hydra

    os.environ["HYDRA_FULL_ERROR"] = "1"  # exceptions reach us instead of being printed by Hydra
    _current.clear()
    typed, sys.argv = sys.argv, ["icub run", *rewritten]
    try:
        with one_line_errors():
            hydra.main(version_base=VERSION_BASE, config_path=str(config_folders()[0]), config_name=PRIMARY)(job)()
    except KeyboardInterrupt:
        if "run_dir" not in _current:
            raise
        raise Interrupted(f"icub: interrupted; to go on: icub run --resume {_current['run_dir']}") from None
    finally:
        sys.argv = typed
    failure = _outcome.pop("error", None)
    if failure is not None:
        raise failure
    return 0


_outcome: dict[str, IcubError] = {}


def job(config: DictConfig) -> dict[str, Any] | None:
    """Carry out one composed run; Hydra calls this, in sweeps once a combination.

    Returns:
        The run's metrics, so that sweepers can optimize them; None when it failed with an expected error.
    """
    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode
    from omegaconf import OmegaConf

    from icub_core.config.compose import check
    from icub_core.config.settings import check_device, pipeline_runner
    from icub_core.files import write_text_atomically

    run_dir = Path(HydraConfig.get().runtime.output_dir)
    _current["run_dir"] = _relative(run_dir)
    try:
        check(config)
        check_device(config)
        config.run_dir = str(run_dir)
        write_text_atomically(run_dir / "config.yaml", OmegaConf.to_yaml(config, resolve=True))
        metrics: dict[str, Any] = pipeline_runner(config.pipeline.name)(config, run_dir)
        return metrics
    except IcubError as error:
        if HydraConfig.get().mode == RunMode.MULTIRUN:
            raise
        # Hydra would print a line of its own for an exception that passes through it
        _outcome["error"] = error
        return None


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
    import yaml

    earlier = [str(word) for word in yaml.safe_load(record.read_text(encoding="utf-8")) or []]
    earlier = [word for word in earlier if not word.startswith("run_dir=")]
    return [*earlier, *words[:position], *words[position + 2 :], f"run_dir={folder}"]


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
