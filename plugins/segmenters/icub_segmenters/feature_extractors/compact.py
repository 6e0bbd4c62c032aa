"""The shipped feature extractor: a compact Mask R-CNN pre-trained on rendered images (see ``network.py``)."""

from __future__ import annotations

from icub_core.errors import ConfigError
from icub_segmenters.feature_extractors.compact_regions import CompactRegions, load_compact
from icub_segmenters.feature_extractors.region_network import RegionExtractor, check_sizes
from icub_segmenters.feature_extractors.resnet_fpn import FpnRegions, find_torchvision_weights
from icub_segmenters.feature_extractors.weights import weights_file


class CompactMaskRcnn(RegionExtractor):
    """Mask R-CNN of 5 M parameters, pre-trained on rendered images; 816 features per region."""

    def __init__(
        self, weights: str = "compact", image_size: list[int] | None = None, proposals: int = 100, mask_size: int = 28
    ) -> None:
        """Load the network.

        Args:
            weights: "compact" (shipped), the path of a file that ``icub train feature_extractor=compact`` wrote, or
                "coco": torchvision's Mask R-CNN ResNet-50-FPN, when its file is at hand.
            image_size: Height and width of the area into which images are scaled; None: 240 x 320 (with "coco": the
                800 to 1333 pixels it was trained with).
            proposals: Regions kept per image.
            mask_size: 28 or 14; with "coco" always 28.

        Raises:
            WeightsError: Missing, truncated or foreign weights.
            ConfigError: A size that makes no sense.
        """
        if mask_size not in (14, 28):
            raise ConfigError(f"mask_size={mask_size}; expected 14 or 28")
        check_sizes(image_size, proposals)
        size = None if image_size is None else (int(image_size[0]), int(image_size[1]))
        if weights == "coco":
            super().__init__(FpnRegions.load(find_torchvision_weights(), size, proposals))
            return
        network, center, scale = load_compact(weights_file(weights))
        network.rpn._post_nms_top_n["testing"] = proposals
        network.rpn._pre_nms_top_n["testing"] = max(300, 3 * proposals)
        super().__init__(CompactRegions(network, center, scale, size or (240, 320), mask_size))
