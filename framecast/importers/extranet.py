"""ExtraNet: what its modified Unreal Engine writes, one EXR a buffer: `<Scene><Buffer>.0001.exr`.

Vectors are pixels, current minus previous, y up; depth is 1 at 100 metres; normals are in Unreal's axes. The compressed
npz files of the same project hold warped and demodulated images for training, no vectors, and cannot become a clip.
"""

from framecast.importers.folder import Found, Listing
from framecast.importers.settings import Color, Depth, Motion, Normal, Scalar, Settings

LOOKS = "files named <Scene>PreTonemapHDRColor.0001.exr and <Scene>MotionVector.0001.exr"

METRES = 100.0
"""What 1 stands for in a depth file."""

MARK = "PreTonemapHDRColor"
BUFFERS = ("BaseColor", "Metallic", "MotionVector", "MyStencil", "Roughness", "SceneDepth", "WorldNormal")
RGB = ("R", "G", "B")


def settings_of(scene: str, buffers: set[str]) -> Settings:
    """Settings of ExtraNet's files, for those of its buffers that there are.

    Args:
        scene: what stands before the buffer's name, with its folder.
    """

    def at(buffer: str) -> tuple[str, ...]:
        return (f"{scene}{buffer}.{{frame}}.exr",)

    def scalar(buffer: str) -> Scalar | None:
        return Scalar(files=at(buffer), channels=("R",)) if buffer in buffers else None

    depth = Depth(files=at("SceneDepth"), channels=("R",), scale=METRES)
    motion = Motion(files=at("MotionVector"), channels=("R", "G"), direction="previous->current", sign=(1.0, -1.0))
    return Settings(
        source="extranet",
        axes="unreal",
        color=Color(files=at(MARK), channels=RGB),
        depth=depth if "SceneDepth" in buffers else None,
        motion=motion if "MotionVector" in buffers else None,
        albedo=Color(files=at("BaseColor"), channels=RGB) if "BaseColor" in buffers else None,
        normal=Normal(files=at("WorldNormal"), channels=RGB) if "WorldNormal" in buffers else None,
        roughness=scalar("Roughness"),
        metallic=scalar("Metallic"),
        object=scalar("MyStencil"),
    )


def recognise(listing: Listing) -> Found | None:
    """What the folder holds if it is laid out like ExtraNet's data, else None."""
    held = listing.patterns()
    for pattern in held:
        if pattern.endswith(f"{MARK}.{{frame}}.exr"):
            scene = pattern.removesuffix(f"{MARK}.{{frame}}.exr")
            buffers = {buffer for buffer in BUFFERS if f"{scene}{buffer}.{{frame}}.exr" in held}
            if "MotionVector" in buffers:
                return Found(settings_of(scene, buffers))
    return None
