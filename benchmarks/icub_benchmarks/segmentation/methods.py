"""The methods that `icub benchmark segmentation` compares, each a segmenter's configuration with changes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from omegaconf import OmegaConf

from icub_core.config.assembly import Assembly
from icub_core.config.compose import compose
from icub_core.construct import build
from icub_core.errors import ConfigError
from icub_core.interfaces.feature_extractor import FeatureExtractor, ImageFeatures
from icub_core.interfaces.segmenter import Segmenter

OURS, OUTPUT_LAYERS, O_OS = "ours", "output_layers", "o_os"
"""Names of the methods that the ratios are taken between."""
EPOCHS = {"tabletop": 16, "handheld": 12}
"""Of the output layers: twice the thesis's, since there are 70 times fewer frames. With 8 on the table-top task mask
mAP50 was 4.6 points lower."""
METHODS = {
    OURS: "falkon",
    "ours_online_rpn": "falkon,segmenter.proposals=online",
    "ours_serial": "ours_serial",
    O_OS: "o_os",
    "linear_softmax": "linear_softmax",
    OUTPUT_LAYERS: "output_layers",
    "store_features": "output_layers,segmenter.store_features=true",
    "one_epoch": "output_layers,segmenter.epochs=1",
    "one_epoch_unshuffled": "output_layers,segmenter.epochs=1,segmenter.shuffle=false",
}
"""By the name in tables and results: output_layers is Mask R-CNN (output layers), the next three are its variants."""
FULL = {
    "mask_rcnn": "mask_rcnn",
    "ours_on_target_features": "falkon,feature_extractor.weights={mask_rcnn}",
    "mask_rcnn_one_epoch": "mask_rcnn,segmenter.epochs=1",
    "mask_rcnn_one_epoch_unshuffled": "mask_rcnn,segmenter.epochs=1,segmenter.shuffle=false",
}
"""With --full; the second takes its features from the network of the first (table 10.2)."""
CURVES = {
    "Ours, batches of the Minibootstrap": [f"falkon,segmenter.batches={n}" for n in (2, 5, 15)] + [OURS],
    "Mask R-CNN (output layers), epochs": [f"output_layers,segmenter.epochs={n}" for n in (1, 4)] + [OUTPUT_LAYERS],
    "Mask R-CNN (store features), epochs": [
        f"output_layers,segmenter.store_features=true,segmenter.epochs={n}" for n in (1, 4)
    ]
    + ["store_features"],
    "Ours, share of pixels r": [f"falkon,segmenter.procedure.pixel_share={r}" for r in (0.01, 0.1)] + [OURS],
}
ABLATION = {
    OURS: "falkon",
    "no pasted clutter": "falkon,segmenter.composites=0",
    "one pasted image a frame": "falkon,segmenter.composites=1",
    "no look-alikes": "falkon,segmenter.procedure.look_alikes=0",
    "distractors not described": "falkon,segmenter.procedure.distractor_boxes=0",
    "bank of negatives": "falkon,segmenter.procedure.bank_images=100",
    "features of the last layer alone": "falkon,features=256:512",
    "no colors and early maps": "falkon,features=0:640",
    "no boxes around true ones": "falkon,segmenter.procedure.jittered_boxes=0",
    "no box voting": "falkon,segmenter.procedure.vote_iou=1",
    "second look (re-pooling)": "falkon,segmenter.repool=true",
    "on-line proposals": "falkon,segmenter.proposals=online",
    "own masks alone": "falkon,segmenter.masks=online",
    "pre-trained masks alone": "falkon,segmenter.masks=pretrained",
    "Algorithm 1 a class": "falkon,segmenter.mode=faithful",
    "a tenth of the negatives": "falkon,segmenter.batches=1",
    "centers half positives": "falkon,online_head.selection=balanced",
}


@dataclass(frozen=True)
class Method:
    """A segmenter with overrides, such as ``falkon,segmenter.batches=2``.

    One kind of overrides is the benchmark's own: ``features=FIRST:LAST``, columns of the region features.
    """

    name: str
    text: str

    @property
    def overrides(self) -> list[str]:
        """Overrides of the configuration."""
        return [o for o in self.text.split(",")[1:] if not o.startswith("features=")]

    def config(self, seed: int, device: str, task: str, network: Path) -> Any:
        """Compose the configuration of one run; only what the segmenter is made of.

        `network` is the folder of the fine-tuned network of this task and run.
        """
        plugin = self.text.split(",")[0]
        overrides = [o.replace("{mask_rcnn}", str(network / "mask_rcnn.safetensors")) for o in self.overrides]
        if plugin == "output_layers" and task in EPOCHS and not any("epochs" in o for o in overrides):
            overrides.append(f"segmenter.epochs={EPOCHS[task]}")
        return compose([f"segmenter={plugin}", f"seed={seed}", f"device={device}", *overrides])

    def segmenter(self, config: Any) -> Segmenter:
        """Build the segmenter of a configuration that `config` composed."""
        plugins = Assembly(config)
        columns = [o.partition("=")[2] for o in self.text.split(",") if o.startswith("features=")]
        if not columns:
            return plugins.get("segmenter")
        first, last = (int(number) for number in columns[0].split(":"))
        few = SomeFeatures(plugins.get("feature_extractor"), slice(first, last))
        head = plugins.get("online_head")
        return build("segmenter", config.segmenter, feature_extractor=few, online_head=head)


class SomeFeatures(FeatureExtractor):
    """Another extractor, of whose region features only some columns are seen."""

    def __init__(self, whole: Any, columns: slice) -> None:
        self._whole, self._columns = whole, columns

    region_dim = property(lambda self: self._columns.stop - self._columns.start)
    mask_dim = property(lambda self: self._whole.mask_dim)
    mask_size = property(lambda self: self._whole.mask_size)

    def extract(self, rgb: Any) -> ImageFeatures:
        """Extract as the whole does."""
        return self._whole.extract(rgb)

    def region_features(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Describe boxes by the chosen columns."""
        return self._whole.region_features(features, boxes)[:, self._columns]

    def mask_features(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Describe pixels as the whole does."""
        return self._whole.mask_features(features, boxes)

    def mask_probabilities(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Draw masks as the whole does."""
        return self._whole.mask_probabilities(features, boxes)

    def rpn_cells(self, features: ImageFeatures) -> Any:
        """Offer the cells of the whole."""
        return self._whole.rpn_cells(features)


def setting(text: str) -> tuple[str, Any]:
    """Read ``key=value``.

    Raises:
        ConfigError: There is no equals sign.
    """
    key, equals, value = text.partition("=")
    if not equals:
        raise ConfigError(f"'{text}' is no setting; expected key=value")
    return key, OmegaConf.create(f"value: {value}").value
