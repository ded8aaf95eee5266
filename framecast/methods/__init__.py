"""Every method by name. A method is `image, state = method(frame, state)`; `method.start(frame)` makes the first state.

Its class says what it needs: `needs` (fields of `Frame` that every shaded frame carries), `needs_generated` (those that
a frame to generate carries besides its time), `modes` ("interpolate" and "extrapolate" make frames that were not
shaded, "pass" makes shaded ones better), `scales` (output size divided by input size that it can be built for, as
`Config.scale`), `history` (how many shaded frames determine an image; None: all since the last reset), `parts` (which
of its methods the runtime compiles) and `step_motion` (whether vectors to the frames left out help it, where a clip has
them).
"""

from collections.abc import Callable
from dataclasses import replace

from torch import nn

from framecast.methods import classifier, extranet, extrass, fasset, ifrnet, mnss, nsrr, refine
from framecast.methods.blend import Blend
from framecast.methods.bsr import BSR
from framecast.methods.classifier import Classifier
from framecast.methods.extranet import ExtraNet
from framecast.methods.extrass import ExtraSS
from framecast.methods.fasset import FASSET
from framecast.methods.filters import Bilinear, Lanczos
from framecast.methods.fsr2 import FSR2
from framecast.methods.guided import GuidedWarp
from framecast.methods.hold import Hold
from framecast.methods.ifrnet import IFRNet
from framecast.methods.mnss import MNSS
from framecast.methods.mobfgsr import Config as MobFGSRConfig
from framecast.methods.mobfgsr import MobFGSR
from framecast.methods.nsrr import NSRR
from framecast.methods.refine import RefinedWarp
from framecast.methods.taau import TAA, TAAU
from framecast.methods.warp3d import Warp3D
from framecast.methods.warps import OcclusionWarp, Warp
from framecast.recipe import Recipe
from framecast.weights import shipped

METHODS: dict[str, Callable[[], nn.Module]] = {
    "hold": Hold,
    "blend": Blend,
    "warp": Warp,
    "warp-occlusion": OcclusionWarp,
    "warp3d": Warp3D,
    "bsr": BSR,
    "mobfgsr": MobFGSR,
    "mobfgsr-quadratic": lambda: MobFGSR(MobFGSRConfig(motion="quadratic")),
    "extranet": lambda: shipped("extranet", ExtraNet(extranet.BETTER)),
    "extranet-plus": lambda: shipped("extranet-plus", ExtraNet(extranet.Config(scale=2))),
    "extrass-warp": GuidedWarp,
    "extrass-refined": lambda: RefinedWarp(refine.MATCHED),
    "extrass": lambda: shipped("extrass", ExtraSS()),
    "extrass-accumulated": lambda: ExtraSS(extrass.ACCUMULATED),
    "fasset": lambda: shipped("fasset", FASSET(fasset.BETTER)),
    "ifrnet": lambda: shipped("ifrnet", IFRNet()),
    "bilinear": Bilinear,
    "lanczos": Lanczos,
    "taa": TAA,
    "taau": TAAU,
    "fsr2": FSR2,
    "nsrr": lambda: shipped("nsrr", NSRR(nsrr.STEADY)),
    "mnss": lambda: shipped("mnss", MNSS()),
    "classifier": lambda: shipped("classifier", Classifier()),
}

TRAINABLE: dict[str, tuple[Callable[[], nn.Module], Recipe]] = {
    "extranet": (lambda: ExtraNet(extranet.BETTER), extranet.better_recipe),
    "extranet-published": (ExtraNet, extranet.recipe),
    "extranet-plus": (lambda: ExtraNet(extranet.Config(scale=2)), extranet.recipe),
    "extranet-without-history": (lambda: ExtraNet(replace(extranet.BETTER, history=False)), extranet.better_recipe),
    "extranet-without-occlusion": (lambda: ExtraNet(replace(extranet.BETTER, occlusion=False)), extranet.better_recipe),
    "extranet-without-shading": (
        lambda: ExtraNet(extranet.BETTER),
        replace(extranet.better_recipe, loss=extranet.loss_without_shading),
    ),
    "extrass": (ExtraSS, extrass.recipe),
    "extrass-refined": (RefinedWarp, refine.recipe),
    "fasset": (lambda: FASSET(fasset.BETTER), fasset.recipe),
    "fasset-published": (FASSET, fasset.published_recipe),
    "fasset-without-gencoder": (lambda: FASSET(replace(fasset.BETTER, gencoder=False)), fasset.recipe),
    "fasset-without-mask": (lambda: FASSET(replace(fasset.BETTER, mask=False)), fasset.recipe),
    "fasset-without-sharing": (lambda: FASSET(replace(fasset.BETTER, shared=False)), fasset.recipe),
    "fasset-without-offset": (lambda: FASSET(replace(fasset.BETTER, offset=False)), fasset.recipe),
    "ifrnet": (IFRNet, ifrnet.recipe),
    "nsrr": (lambda: NSRR(nsrr.STEADY), nsrr.steady_recipe),
    "nsrr-five-frames": (lambda: NSRR(nsrr.FAST), nsrr.recipe),
    "mnss": (MNSS, mnss.recipe),
    "classifier": (Classifier, classifier.recipe),
    "classifier-true-labels": (Classifier, replace(classifier.recipe, loss=classifier.loss_with_true_labels)),
    "classifier-none": (lambda: Classifier(classifier.Config(classifier=False)), classifier.recipe),
    "classifier-without-counter": (lambda: Classifier(classifier.Config(counter=False)), classifier.recipe),
    "classifier-without-carried": (lambda: Classifier(classifier.Config(carried=False)), classifier.recipe),
    "classifier-without-range": (lambda: Classifier(classifier.Config(range=False)), classifier.recipe),
}
"""Networks with random weights, and their recipes. Without history, occlusion and shading are the paper's ablations;
"published" adds its output to the plain warp everywhere, the others to one whose holes are filled, where it changes."""
