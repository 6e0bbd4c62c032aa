"""O-OS: on-line detection and masks on the regions of the pre-trained network (thesis chapter 10)."""

from __future__ import annotations

from collections.abc import Callable

from icub_core.interfaces.feature_extractor import FeatureExtractor
from icub_core.interfaces.online_head import OnlineHead
from icub_segmenters.online_segmenter import OnlineSegmenter
from icub_segmenters.procedure import Procedure


class OnlineObjectSegmentation(OnlineSegmenter):
    """Baseline O-OS (thesis 10.3): one Minibootstrap per class on pre-trained proposals, on-line masks alone.

    Beyond the thesis, boxes drawn around true ones are positives, too, which makes the baseline stronger.
    """

    def __init__(
        self,
        feature_extractor: FeatureExtractor,
        online_head: Callable[[], OnlineHead],
        batches: int = 15,
        batch_size: int = 2000,
        seed: int = 0,
    ) -> None:
        """Configure; see `OnlineSegmenter`.

        Args:
            feature_extractor: Proposes and describes regions.
            online_head: Gives an untrained classifier; the thesis chooses centers with ``selection=balanced``.
            batches: Batches of negatives per class (n_B).
            batch_size: Negatives per batch (BS).
            seed: Decides everything random.
        """
        super().__init__(
            feature_extractor,
            online_head,
            mode="faithful",
            batches=batches,
            batch_size=batch_size,
            composites=0,
            masks="online",
            repool=False,
            seed=seed,
            procedure=Procedure(vote_iou=1.0),
        )
