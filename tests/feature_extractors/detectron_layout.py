"""Checkpoints in the exact key layout of Detectron2's Mask R-CNN files, with random tensors, and plain arithmetic."""

import torch
from torch.nn import functional

STAGES = {2: (3, 64, 64, 256), 3: (4, 256, 128, 512), 4: (6, 512, 256, 1024), 5: (3, 1024, 512, 2048)}


def conv_and_norm(tensors, name, outputs, inputs, kernel, generator):
    fan = inputs * kernel * kernel
    tensors[f"{name}.weight"] = torch.randn(outputs, inputs, kernel, kernel, generator=generator) * (1.5 / fan) ** 0.5
    tensors[f"{name}.norm.weight"] = torch.rand(outputs, generator=generator) * 0.4 + 0.6
    tensors[f"{name}.norm.bias"] = torch.randn(outputs, generator=generator) * 0.05
    tensors[f"{name}.norm.running_mean"] = torch.randn(outputs, generator=generator) * 0.05
    tensors[f"{name}.norm.running_var"] = torch.rand(outputs, generator=generator) * 0.4 + 0.8


def stage(tensors, prefix, number, generator):
    blocks, inputs, middle, outputs = STAGES[number]
    for block in range(blocks):
        name = f"{prefix}res{number}.{block}"
        before = inputs if block == 0 else outputs
        if block == 0:
            conv_and_norm(tensors, f"{name}.shortcut", outputs, before, 1, generator)
        conv_and_norm(tensors, f"{name}.conv1", middle, before, 1, generator)
        conv_and_norm(tensors, f"{name}.conv2", middle, middle, 3, generator)
        conv_and_norm(tensors, f"{name}.conv3", outputs, middle, 1, generator)


def layer(tensors, name, *shape, generator, bias=None):
    fan = torch.tensor(shape[1:]).prod().item()
    tensors[f"{name}.weight"] = torch.randn(*shape, generator=generator) * (1.0 / fan) ** 0.5
    tensors[f"{name}.bias"] = torch.randn(shape[0] if bias is None else bias, generator=generator) * 0.02


def c4(classes=80, seed=0):
    """Tensors of mask_rcnn_R_50_C4."""
    g, t = torch.Generator().manual_seed(seed), {}
    t["pixel_mean"], t["pixel_std"] = torch.zeros(3, 1, 1), torch.ones(3, 1, 1)
    conv_and_norm(t, "backbone.stem.conv1", 64, 3, 7, g)
    for number in (2, 3, 4):
        stage(t, "backbone.", number, g)
    t["proposal_generator.anchor_generator.cell_anchors.0"] = torch.zeros(15, 4)
    layer(t, "proposal_generator.rpn_head.conv", 1024, 1024, 3, 3, generator=g)
    layer(t, "proposal_generator.rpn_head.objectness_logits", 15, 1024, 1, 1, generator=g)
    layer(t, "proposal_generator.rpn_head.anchor_deltas", 60, 1024, 1, 1, generator=g)
    stage(t, "roi_heads.", 5, g)
    layer(t, "roi_heads.box_predictor.cls_score", classes + 1, 2048, generator=g)
    layer(t, "roi_heads.box_predictor.bbox_pred", 4 * classes, 2048, generator=g)
    layer(t, "roi_heads.mask_head.deconv", 2048, 256, 2, 2, generator=g, bias=256)
    layer(t, "roi_heads.mask_head.predictor", classes, 256, 1, 1, generator=g)
    # random trunks give large activations; anchors shall not move out of the image
    t["proposal_generator.rpn_head.objectness_logits.weight"] *= 0.05
    t["proposal_generator.rpn_head.anchor_deltas.weight"] *= 0.001
    return t


def fpn(classes=80, seed=0):
    """Tensors of mask_rcnn_R_50_FPN."""
    g, t = torch.Generator().manual_seed(seed), {}
    for level, channels in ((2, 256), (3, 512), (4, 1024), (5, 2048)):
        layer(t, f"backbone.fpn_lateral{level}", 256, channels, 1, 1, generator=g)
        layer(t, f"backbone.fpn_output{level}", 256, 256, 3, 3, generator=g)
    conv_and_norm(t, "backbone.bottom_up.stem.conv1", 64, 3, 7, g)
    for number in (2, 3, 4, 5):
        stage(t, "backbone.bottom_up.", number, g)
    for level in range(5):
        t[f"proposal_generator.anchor_generator.cell_anchors.{level}"] = torch.zeros(3, 4)
    layer(t, "proposal_generator.rpn_head.conv", 256, 256, 3, 3, generator=g)
    layer(t, "proposal_generator.rpn_head.objectness_logits", 3, 256, 1, 1, generator=g)
    layer(t, "proposal_generator.rpn_head.anchor_deltas", 12, 256, 1, 1, generator=g)
    layer(t, "roi_heads.box_head.fc1", 1024, 256 * 7 * 7, generator=g)
    layer(t, "roi_heads.box_head.fc2", 1024, 1024, generator=g)
    layer(t, "roi_heads.box_predictor.cls_score", classes + 1, 1024, generator=g)
    layer(t, "roi_heads.box_predictor.bbox_pred", 4 * classes, 1024, generator=g)
    for i in range(1, 5):
        layer(t, f"roi_heads.mask_head.mask_fcn{i}", 256, 256, 3, 3, generator=g)
    layer(t, "roi_heads.mask_head.deconv", 256, 256, 2, 2, generator=g, bias=256)
    layer(t, "roi_heads.mask_head.predictor", classes, 256, 1, 1, generator=g)
    return t


def run_conv(tensors, name, x, stride=1):
    weight = tensors[f"{name}.weight"]
    x = functional.conv2d(x, weight, stride=stride, padding=weight.shape[-1] // 2)
    mean, var, scale, shift = (
        tensors[f"{name}.norm.{leaf}"][:, None, None] for leaf in ("running_mean", "running_var", "weight", "bias")
    )
    return (x - mean) / torch.sqrt(var + 1e-5) * scale + shift


def run_stage(tensors, prefix, number, x):
    """The stage with the stride in the first 1x1 convolution, as these checkpoints were trained."""
    for block in range(STAGES[number][0]):
        name = f"{prefix}res{number}.{block}"
        stride = 2 if block == 0 and number > 2 else 1
        short = run_conv(tensors, f"{name}.shortcut", x, stride) if block == 0 else x
        y = functional.relu(run_conv(tensors, f"{name}.conv1", x, stride))
        y = functional.relu(run_conv(tensors, f"{name}.conv2", y))
        x = functional.relu(run_conv(tensors, f"{name}.conv3", y) + short)
    return x


def run_trunk(tensors, prefix, bgr):
    """Stem and stages 2 to 4 on a mean-free BGR image (1, 3, H, W); all stage outputs."""
    x = functional.relu(run_conv(tensors, f"{prefix}stem.conv1", bgr, 2))
    x = functional.max_pool2d(x, 3, 2, 1)
    outputs = []
    for number in (2, 3, 4):
        x = run_stage(tensors, prefix, number, x)
        outputs.append(x)
    return outputs
