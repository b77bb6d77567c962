"""Masks followed through a sequence of photos by the video model of SAM 2 (Ravi et al., 2024)."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import torch
from torch.nn.functional import interpolate

from gaga_core.arrays import BoolArray, UInt8Array
from gaga_core.segmentation.loading import choose_device, load_folder, normalized
from gaga_core.segmentation.settings import Device

if TYPE_CHECKING:
    from torch import Tensor

_MEAN, _STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)

# photos (F, each H, W, 3) of one size, masks (k, H, W) on the first -> masks (k, H, W) of each
Follow = Callable[[Sequence[UInt8Array], BoolArray], Iterator[BoolArray]]


def load_follower(folder: Path, device: Device = "auto") -> Follow:
    """The SAM 2 video model in ``folder``, as transformers saves it.

    Raises ``GagaError`` where transformers is missing or the folder holds no such model.
    """
    place = choose_device(device)
    model = cast(Any, load_folder("video_masks", folder)).to(place)
    side = int(model.config.image_size)

    def follow(photos: Sequence[UInt8Array], masks: BoolArray) -> Iterator[BoolArray]:
        height, width = photos[0].shape[:2]
        frames = [normalized(photo, side, side, _MEAN, _STD)[0] for photo in photos]
        session = _session(torch.stack(frames), masks, side, place)
        for output in model.propagate_in_video_iterator(session, start_frame_idx=0):
            logits = output.pred_masks.float()
            shown = interpolate(logits, (height, width), mode="bilinear", align_corners=False)
            found: BoolArray = (shown[:, 0] > 0).cpu().numpy()
            yield found

    return follow


def _session(frames: "Tensor", masks: BoolArray, side: int, place: torch.device) -> object:
    """A film of frames (F, 3, side, side) whose first one shows the objects ``masks`` (k, H, W)."""
    from transformers.models.sam2_video.modeling_sam2_video import Sam2VideoInferenceSession

    height, width = masks.shape[1:]
    session = Sam2VideoInferenceSession(
        video=frames,
        video_height=height,
        video_width=width,
        inference_device=place,
        dtype=torch.float32,
    )
    for k, mask in enumerate(masks):
        at = session.obj_id_to_idx(k + 1)
        shown = torch.from_numpy(mask.astype(np.float32))[None, None]
        small = interpolate(shown, (side, side), mode="bilinear", antialias=True)
        session.add_mask_inputs(at, 0, (small >= 0.5).float())
    session.obj_with_new_inputs = list(session.obj_ids)
    return session
