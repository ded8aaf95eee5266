"""`framecast doctor`: what the buffers of a folder mean, found out by experiment.

examined = examine("dump")            every experiment
print(examined.report.text())         in words; .json() for machines
draw(examined, Path("doctor.png"))    the picture that convinces

Order of reading: `source` (files and claims) -> `take` (frames to look at) -> `probe`, `motion`, `search` (vectors),
`jitter`, `camera`, `depth`, `surface`, `edges` (experiments), `follow`, `timeline` (frame by frame) -> `say_...`
(words) -> `examine`.
"""

from framecast.doctor.examine import Examined, examine
from framecast.doctor.picture import draw

__all__ = ["Examined", "draw", "examine"]
