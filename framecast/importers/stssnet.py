"""STSSNet: `compressed.0001.NoWarp.npy`, 33 to 35 channels of half floats, and `HR/compressedHR.0001.npy`, twice the
size.

Triplets are B, G, R. Colour is the one at twice the size, since the other holds warped images; buffers are enlarged to
it. Its authors do not define motion: it is read as that of ExtraNet, whose exporter they use.
"""

from framecast.importers import images
from framecast.importers.extranet import METRES
from framecast.importers.folder import Found, Listing
from framecast.importers.settings import Color, Depth, Motion, Normal, Scalar, Settings

LOOKS = "files named compressed.0001.NoWarp.npy and HR/compressedHR.0001.npy"

BUFFERS = "compressed.{frame}.NoWarp.npy"
COLOR = "HR/compressedHR.{frame}.npy"
WIDE = 35
"""Channels from which on the vectors stand one channel later."""


def settings_of(channels: int, buffers: str = BUFFERS, color: str = COLOR) -> Settings:
    """Settings of STSSNet's files with so many channels."""
    at, later = (buffers,), int(channels >= WIDE)
    vectors = (str(32 + later), str(31 + later))
    return Settings(
        source="stssnet",
        axes="unreal",
        color=Color(files=(color,), channels=("2", "1", "0"), encoding="srgb"),
        depth=Depth(files=at, channels=("26",), scale=METRES),
        motion=Motion(files=at, channels=vectors, direction="previous->current", sign=(1.0, -1.0)),
        albedo=Color(files=at, channels=("23", "22", "21")),
        normal=Normal(files=at, channels=("29", "28", "27")),
        roughness=Scalar(files=at, channels=("25",)),
        metallic=Scalar(files=at, channels=("24",)),
        notes=("colour is 0..1 as displayed and was read as sRGB; its authors do not say",),
    )


def recognise(listing: Listing) -> Found | None:
    """What the folder holds if it is laid out like STSSNet's data, else None."""
    held = listing.patterns()
    buffers = next((p for p in held if p.rpartition("/")[2] == BUFFERS), None)
    color = next((p for p in held if p.endswith(COLOR)), None)
    if buffers is None or color is None:
        return None
    about = images.about(listing.folder / held[buffers])
    return Found(settings_of(len(about.names), buffers, color))
