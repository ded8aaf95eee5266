"""Every method by name. A method is `image, state = method(frame, state)`; `method.start(frame)` makes the first state.

Its class says what it needs: `needs` (fields of `Frame` that every shaded frame carries), `needs_generated` (those that
a frame to generate carries besides its time), `modes`, `history` (how many shaded frames determine an image; None: all
since the last reset), `parts` (which of its methods
the runtime compiles) and `step_motion` (whether vectors to the frames left out help it, where a clip has them).
"""

from collections.abc import Callable

from torch import nn

from framecast.methods.blend import Blend
from framecast.methods.bsr import BSR
from framecast.methods.hold import Hold
from framecast.methods.mobfgsr import Config as MobFGSRConfig
from framecast.methods.mobfgsr import MobFGSR
from framecast.methods.warp3d import Warp3D
from framecast.methods.warps import OcclusionWarp, Warp

METHODS: dict[str, Callable[[], nn.Module]] = {
    "hold": Hold,
    "blend": Blend,
    "warp": Warp,
    "warp-occlusion": OcclusionWarp,
    "warp3d": Warp3D,
    "bsr": BSR,
    "mobfgsr": MobFGSR,
    "mobfgsr-quadratic": lambda: MobFGSR(MobFGSRConfig(motion="quadratic")),
}
