"""The models that are known by name."""

from dataclasses import dataclass
from typing import Literal

from gaga_core.errors import GagaError

# What `gaga masks`, --index-with, --detector take, and what places photos.
Purpose = Literal["masks", "words", "boxes", "matches"]


@dataclass(frozen=True)
class KnownModel:
    """A model whose weights a person can get; sizes are about, licences as their pages say."""

    name: str  # as `gaga masks --provider` takes it; also the folder of its masks
    title: str
    hub: str  # repository on the Hugging Face hub
    megabytes: int  # of the weights
    licence: str
    note: str = ""
    file: str = ""  # an original checkpoint that does as well
    purpose: Purpose = "masks"
    is_gated: bool = False  # its page asks who you are before it gives the weights
    gigaflop: float = 0.0  # work for a photo without a graphics card (256 points); 0 = not known

    @property
    def page(self) -> str:
        """The source of the weights."""
        return f"https://huggingface.co/{self.hub}"


_GPU = "for a graphics card"

# fmt: off
KNOWN = (
    KnownModel("sam2.1-tiny", "SAM 2.1 Hiera tiny", "facebook/sam2.1-hiera-tiny", 156,
               "Apache-2.0", "the best choice without a graphics card", gigaflop=3950),
    KnownModel("sam2.1-small", "SAM 2.1 Hiera small", "facebook/sam2.1-hiera-small", 184,
               "Apache-2.0", gigaflop=4140),
    KnownModel("sam2.1-base", "SAM 2.1 Hiera base plus", "facebook/sam2.1-hiera-base-plus", 323,
               "Apache-2.0", gigaflop=4580),
    KnownModel("sam2.1-large", "SAM 2.1 Hiera large", "facebook/sam2.1-hiera-large", 898,
               "Apache-2.0", _GPU, gigaflop=5710),
    KnownModel("sam-base", "SAM ViT-B", "facebook/sam-vit-base", 375,
               "Apache-2.0", file="sam_vit_b_01ec64.pth", gigaflop=4480),
    KnownModel("sam-large", "SAM ViT-L", "facebook/sam-vit-large", 1250,
               "Apache-2.0", _GPU, "sam_vit_l_0b3195.pth"),
    KnownModel("sam-huge", "SAM ViT-H", "facebook/sam-vit-huge", 2564,
               "Apache-2.0", f"the paper's; {_GPU}", "sam_vit_h_4b8939.pth"),
    KnownModel("sam-hq-base", "SAM-HQ ViT-B", "syscv-community/sam-hq-vit-base", 379,
               "Apache-2.0"),
    KnownModel("sam-hq-huge", "SAM-HQ ViT-H", "syscv-community/sam-hq-vit-huge", 2570,
               "Apache-2.0", _GPU),
    KnownModel("sam3", "SAM 3 (tracker)", "facebook/sam3", 3440,
               "SAM License", f"its page asks for your name and consent; {_GPU}", is_gated=True),
    KnownModel("mask2former-tiny", "Mask2Former Swin-T, COCO instances",
               "facebook/mask2former-swin-tiny-coco-instance", 190, "see its page"),
    KnownModel("mask2former-large", "Mask2Former Swin-L, COCO panoptic",
               "facebook/mask2former-swin-large-coco-panoptic", 866, "see its page", _GPU),
)

# Models of words and pictures, for searching groups by meaning (`gaga query --index-with`).
KNOWN_EMBEDDERS = (
    KnownModel("clip-base", "CLIP ViT-B/32", "openai/clip-vit-base-patch32", 605,
               "MIT", "the best choice without a graphics card", purpose="words"),
    KnownModel("clip-large", "CLIP ViT-L/14", "openai/clip-vit-large-patch14", 1710,
               "MIT", _GPU, purpose="words"),
    KnownModel("siglip-base", "SigLIP B/16", "google/siglip-base-patch16-224", 813,
               "Apache-2.0", purpose="words"),
    KnownModel("siglip2-base", "SigLIP 2 B/16", "google/siglip2-base-patch16-224", 1500,
               "Apache-2.0", purpose="words"),
)
# Detectors of phrases, for finding groups in one view (`gaga query --detector`).
KNOWN_DETECTORS = (
    KnownModel("grounding-dino-tiny", "Grounding DINO Swin-T", "IDEA-Research/grounding-dino-tiny",
               690, "Apache-2.0", purpose="boxes"),
    KnownModel("grounding-dino-base", "Grounding DINO Swin-B", "IDEA-Research/grounding-dino-base",
               933, "Apache-2.0", f"the paper's; {_GPU}", purpose="boxes"),
    KnownModel("owlv2-base", "OWLv2 B/16", "google/owlv2-base-patch16-ensemble", 620,
               "Apache-2.0", purpose="boxes"),
)
# Matches between photos that are hard to place (`gaga run`, `gaga reconstruct`).
MATCHER = KnownModel("efficientloftr", "EfficientLoFTR", "zju-community/efficientloftr", 64,
                     "Apache-2.0", "wide angles and shine", purpose="matches")
# fmt: on
CATALOGUE = (*KNOWN, *KNOWN_EMBEDDERS, *KNOWN_DETECTORS, MATCHER)


def known_model(name: str) -> KnownModel:
    """The known model called ``name``, by its own name or its repository's; ``GagaError`` else."""
    for model in CATALOGUE:
        if name in (model.name, model.hub):
            return model
    names = ", ".join(model.name for model in CATALOGUE)
    raise GagaError(f"There is no known model {name!r}. Choose one of {names}.")
