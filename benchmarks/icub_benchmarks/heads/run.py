"""On-line heads against scikit-learn and against the arithmetic limit of the machine; memory of the region store.

    icub benchmark heads
    icub benchmark heads --parts minibootstrap --seed 1
    icub benchmark heads --quick                      # a smoke test: small sizes, meaningless figures

Features are synthetic but have the structure of region features: every class and every kind of background is a mixture
of views in a latent space, seen through random rectified units, so that classes overlap and some background is hard.
Ours and scikit-learn get the same arrays, kernel width, lambda, number of centers, batches and thresholds in the same
run and with the same number of threads; average precisions are measured on samples that nobody trained on.

- minibootstrap: all classes by the Minibootstrap. The baseline is the faithful loop (Algorithm 1), each class with its
  own negatives and centers, with Nystroem + Ridge in it. Ours once in that faithful mode (``_faithful``) and once
  shared: one pool of negatives and one set of centers for all classes.
- limit: the shared direct solve; its arithmetic is the kernel rows, half of the symmetric Gram matrix, right sides,
  the kernel matrix of the centers, factorization and substitution.
- sweep: single solves, n, d, M and the number of classes varied one at a time; time, accuracy and memory against
  Nystroem + Ridge, once against SVC, and against the FALKON library where it is installed; a table and a plot appear
  beside the results file.
- store: memory of all classes' negatives, features kept once and classes holding row numbers.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

from rich.console import Console
from rich.progress import Progress

from icub_benchmarks.figures import write_results
from icub_benchmarks.heads.data import QUICK, Sizes
from icub_benchmarks.heads.parts import limit, minibootstrap, store
from icub_benchmarks.heads.sweep import sweep, write_report
from icub_benchmarks.results import command_line, make_parser

PARTS = {"limit": limit, "store": store, "sweep": sweep, "minibootstrap": minibootstrap}


def main(argv: Sequence[str]) -> int:
    """Measure and write heads.json after each part, so that an interrupted run keeps the others."""
    parser = make_parser("heads", __doc__)
    parser.add_argument("--parts", nargs="+", choices=tuple(PARTS), default=tuple(PARTS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="small sizes, to see that everything runs")
    options = parser.parse_args(argv)
    sizes = QUICK if options.quick else Sizes()
    file, command = options.results / "heads.json", command_line("heads", argv)
    console = Console(stderr=True)
    try:
        with Progress(console=console) as progress:
            for part in options.parts:
                for figures in PARTS[part](sizes, options.seed, progress):
                    write_results(file, command=command, seed=options.seed, figures=figures)
                    for key, figure in figures.items():
                        progress.print(f"{key:56s} {figure.value:10.3f} {figure.unit}", highlight=False)
    except KeyboardInterrupt:
        console.print("stopped; finished parts are kept, --parts names the others")
        return 130
    written = write_report(file.with_name("heads_sweep"), json.loads(file.read_text())["figures"])
    for path in (file, *written):
        print(f"written: {path}")
    return 0
