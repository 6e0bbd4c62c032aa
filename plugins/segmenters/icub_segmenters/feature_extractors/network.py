"""A Mask R-CNN small enough for two CPU cores: 5 M parameters on torchvision's detection parts.

Differences from torchvision's ``MaskRCNN``, each chosen by measurement on a CPU: a thin ResNet with FPN on strides 8
to 32, a 2 x 256 box head, a mask head of two 64-channel convolutions, and box refinement and masks that do not depend
on the class, so that both serve objects which the network has never seen.
"""

from __future__ import annotations

from collections import OrderedDict

import torch
from torch import nn
from torch.nn import functional
from torchvision.models.detection.image_list import ImageList
from torchvision.models.detection.roi_heads import RoIHeads, fastrcnn_loss, project_masks_on_boxes
from torchvision.models.detection.rpn import AnchorGenerator, RegionProposalNetwork, RPNHead
from torchvision.ops import FeaturePyramidNetwork, MultiScaleRoIAlign

LEVELS = ["0", "1", "2"]
ANCHOR_SIZES = ((16, 28), (40, 56), (80, 120))
ASPECT_RATIOS = (0.5, 1.0, 2.0)
WIDTHS = (32, 64, 128, 256)
DEPTHS = (1, 2, 2, 2)
FPN_CHANNELS = 128
BOX_DIM = 256
MASK_DIM = 64
MASK_SIZE = 28
_MEAN, _STD = 0.45, 0.25


def _conv(inputs: int, outputs: int, kernel: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False),
        nn.BatchNorm2d(outputs),
    )


class _BasicBlock(nn.Module):
    """Two 3x3 convolutions with a shortcut (He et al. 2016)."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.first = _conv(inputs, outputs, 3, stride)
        self.second = _conv(outputs, outputs, 3)
        same = stride == 1 and inputs == outputs
        self.shortcut: nn.Module = nn.Identity() if same else _conv(inputs, outputs, 1, stride)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return functional.relu(self.second(functional.relu(self.first(x))) + self.shortcut(x))


class CompactBackbone(nn.Module):
    """ResNet of widths 32 to 256 with FPN: maps "0" to "2" at strides 8 to 32, and "low" at stride 4."""

    out_channels = FPN_CHANNELS
    low_channels = WIDTHS[0]

    def __init__(self) -> None:
        super().__init__()
        self.stem = nn.Sequential(_conv(3, 24, 5, 2), nn.ReLU(), nn.MaxPool2d(3, 2, 1))
        stages, inputs = [], 24
        for index, (width, depth) in enumerate(zip(WIDTHS, DEPTHS, strict=True)):
            blocks = [_BasicBlock(inputs, width, 1 if index == 0 else 2)]
            blocks += [_BasicBlock(width, width, 1) for _ in range(depth - 1)]
            stages.append(nn.Sequential(*blocks))
            inputs = width
        self.stages = nn.ModuleList(stages)
        self.fpn = FeaturePyramidNetwork(list(WIDTHS[1:]), FPN_CHANNELS)

    def forward(self, images: torch.Tensor) -> tuple[OrderedDict[str, torch.Tensor], torch.Tensor]:
        """Map images (B, 3, H, W) to the pyramid and the stride-4 map (B, 32, H/4, W/4)."""
        low = self.stages[0](self.stem(images))
        maps, x = OrderedDict(), low
        for name, stage in zip(LEVELS, list(self.stages)[1:], strict=True):
            x = stage(x)
            maps[name] = x
        return self.fpn(maps), low


class _BoxHead(nn.Module):
    """Two fully connected layers on the pooled region."""

    def __init__(self) -> None:
        super().__init__()
        self.fc6 = nn.Linear(FPN_CHANNELS * 49, BOX_DIM)
        self.fc7 = nn.Linear(BOX_DIM, BOX_DIM)

    def layers(self, pooled: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Both activations (N, 256) of pooled regions (N, 128, 7, 7)."""
        first = functional.relu(self.fc6(pooled.flatten(1)))
        return first, functional.relu(self.fc7(first))

    def forward(self, pooled: torch.Tensor) -> torch.Tensor:
        return self.layers(pooled)[1]


class _BoxPredictor(nn.Module):
    """Class scores (N, C + 1) and one refinement (N, 4) for whatever class it is."""

    def __init__(self, classes: int) -> None:
        super().__init__()
        self.cls_score = nn.Linear(BOX_DIM, classes + 1)
        self.bbox_pred = nn.Linear(BOX_DIM, 4)

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.cls_score(x), self.bbox_pred(x)


class _MaskHead(nn.Sequential):
    """(N, 128, 14, 14) to (N, 64, 28, 28)."""

    def __init__(self) -> None:
        super().__init__(
            nn.Conv2d(FPN_CHANNELS, MASK_DIM, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(MASK_DIM, MASK_DIM, 3, padding=1),
            nn.ReLU(),
            nn.ConvTranspose2d(MASK_DIM, MASK_DIM, 2, 2),
            nn.ReLU(),
        )


class _CompactRoIHeads(RoIHeads):
    """torchvision's sampling and matching with class-agnostic boxes and masks."""

    def losses(
        self,
        maps: OrderedDict[str, torch.Tensor],
        proposals: list[torch.Tensor],
        sizes: list[tuple[int, int]],
        targets: list[dict[str, torch.Tensor]],
    ) -> dict[str, torch.Tensor]:
        """Classification, box and mask losses of the sampled proposals."""
        proposals, matched, labels, box_targets = self.select_training_samples(proposals, targets)
        scores, boxes = self.box_predictor(self.box_head(self.box_roi_pool(maps, proposals, sizes)))
        twice = torch.cat([torch.zeros_like(boxes), boxes], dim=1)  # background, any object
        anything = [label.clamp(max=1) for label in labels]
        _, box_loss = fastrcnn_loss(scores[:, :2], twice, anything, box_targets)
        class_loss = functional.cross_entropy(scores, torch.cat(labels))
        positive = [torch.where(label > 0)[0] for label in labels]
        regions = [p[i] for p, i in zip(proposals, positive, strict=True)]
        logits = self.mask_predictor(self.mask_head(self.mask_roi_pool(maps, regions, sizes)))[:, 0]
        truth = torch.cat(
            [
                project_masks_on_boxes(t["masks"], r, m[i], MASK_SIZE)
                for t, r, m, i in zip(targets, regions, matched, positive, strict=True)
            ]
        )
        mask_loss = functional.binary_cross_entropy_with_logits(logits, truth)
        return {"class": class_loss, "box": box_loss, "mask": mask_loss}


class CompactNetwork(nn.Module):
    """The whole network."""

    def __init__(self, classes: int, proposals: int = 100) -> None:
        """Build with random weights.

        Args:
            classes: Classes without the background.
            proposals: Regions kept an image after non-maximum suppression.
        """
        super().__init__()
        self.classes = classes
        self.backbone = CompactBackbone()
        anchors = AnchorGenerator(ANCHOR_SIZES, (ASPECT_RATIOS,) * len(ANCHOR_SIZES))
        self.rpn = RegionProposalNetwork(
            anchors,
            RPNHead(FPN_CHANNELS, anchors.num_anchors_per_location()[0]),
            fg_iou_thresh=0.7,
            bg_iou_thresh=0.3,
            batch_size_per_image=128,
            positive_fraction=0.5,
            pre_nms_top_n={"training": 300, "testing": max(300, 3 * proposals)},
            post_nms_top_n={"training": 100, "testing": proposals},
            nms_thresh=0.7,
        )
        # regions go to the level where a bin is at most 1.4 cells wide, so one sample a bin is enough; the scattered
        # gradient of four samples was a quarter of a training step
        self.roi_heads = _CompactRoIHeads(
            MultiScaleRoIAlign(LEVELS, 7, 1, canonical_scale=80, canonical_level=4),
            _BoxHead(),
            _BoxPredictor(classes),
            fg_iou_thresh=0.5,
            bg_iou_thresh=0.5,
            batch_size_per_image=64,
            positive_fraction=1 / 3,
            bbox_reg_weights=None,
            score_thresh=0.05,
            nms_thresh=0.5,
            detections_per_img=50,
            mask_roi_pool=MultiScaleRoIAlign(LEVELS, 14, 1, canonical_scale=80, canonical_level=4),
            mask_head=_MaskHead(),
            mask_predictor=nn.Conv2d(MASK_DIM, 1, 1),
        )
        for module in self.modules():
            if isinstance(module, nn.Conv2d | nn.ConvTranspose2d) and module.bias is None:
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    @staticmethod
    def normalize(images: torch.Tensor) -> torch.Tensor:
        """Bring images (B, 3, H, W) from 0..255 to about -2..2."""
        return (images.float() / 255.0 - _MEAN) / _STD

    def losses(self, images: torch.Tensor, targets: list[dict[str, torch.Tensor]]) -> dict[str, torch.Tensor]:
        """Return the five losses of a batch.

        Args:
            images: (B, 3, H, W) uint8.
            targets: Per image: boxes (N, 4) xyxy px, labels (N,) from 1, masks (N, H, W) uint8; N > 0.
        """
        sizes = [(images.shape[2], images.shape[3])] * len(images)
        # float32 on purpose: bfloat16 took 143 instead of 103 ms of one core an image where it was measured (no AMX)
        maps, _ = self.backbone(self.normalize(images).contiguous(memory_format=torch.channels_last))
        boxes, rpn = self.rpn(ImageList(images, sizes), maps, targets)
        heads = self.roi_heads.losses(maps, boxes, sizes, targets)
        return {"objectness": rpn["loss_objectness"], "rpn_box": rpn["loss_rpn_box_reg"], **heads}

    def propose(
        self, images: torch.Tensor
    ) -> tuple[OrderedDict[str, torch.Tensor], torch.Tensor, torch.Tensor, torch.Tensor]:
        """Run backbone and RPN on one image (1, 3, H, W) uint8: maps, stride-4 map, proposals (P, 4), scores (P,)."""
        maps, low = self.backbone(self.normalize(images).contiguous(memory_format=torch.channels_last))
        sizes = [(images.shape[2], images.shape[3])]
        features = list(maps.values())
        objectness, deltas = self.rpn.head(features)
        anchors = self.rpn.anchor_generator(ImageList(images, sizes), features)
        counts = [o[0].numel() for o in objectness]
        logits = torch.cat([o.permute(0, 2, 3, 1).reshape(1, -1) for o in objectness], dim=1)
        flat = torch.cat([_per_anchor(d) for d in deltas], dim=1)
        boxes = self.rpn.box_coder.decode(flat[0], anchors).view(1, -1, 4)
        kept, scores = self.rpn.filter_proposals(boxes, logits.reshape(-1, 1), sizes, counts)
        return maps, low, kept[0], scores[0]


def _per_anchor(deltas: torch.Tensor) -> torch.Tensor:
    """(B, 4A, H, W) to (B, H * W * A, 4), the order of the anchors."""
    batch, channels, height, width = deltas.shape
    return deltas.view(batch, channels // 4, 4, height, width).permute(0, 3, 4, 1, 2).reshape(batch, -1, 4)
