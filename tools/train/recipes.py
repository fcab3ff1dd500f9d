"""What each network is trained for: its input, its classes, and what was found to serve it best."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from tools.train.crops import Augmentation


@dataclass(frozen=True, slots=True)
class DetectorRecipe:
    """A detector of persons, vehicles and bicycles."""

    name: str  #: in the registry
    description: str
    size: tuple[int, int]  #: (width, height) of its input
    channels: int
    odds: Mapping[str, float]  #: its classes in order, and how often a crop is made around each
    augmentation: Augmentation = field(default_factory=Augmentation)
    side: int = 256  #: of a crop
    batch_size: int = 16  #: crops of a step
    slim: bool = False  #: a residual backbone of half the work

    @property
    def color(self) -> str:
        """The channel order, in the registry's words."""
        return "gray" if self.channels == 1 else "rgb"

    @property
    def class_map(self) -> Mapping[int, str]:
        """The network's classes as ours."""
        return dict(enumerate(self.odds))


#: A color camera looks ahead: nothing is upside down or on its side. It flies at the heights that
#: it is trained at, so objects are as large as in the data, and the simulated light is even.
AHEAD = Augmentation(
    zoom=(0.8, 1.5),
    upside_down=0.0,
    quarter_turn=0.0,
    contrast=(0.85, 1.2),
    gamma=(0.85, 1.2),
    brightness=20.0,
    noise=4.0,
)

#: Size tells a parked motorcycle from a car, so objects are nearly as large as in the data.
FROM_ABOVE = Augmentation(zoom=(0.7, 1.5), quarter_turn=0.0)

DETECT_THERMAL = DetectorRecipe(
    name="detect-thermal",
    description="Persons, vehicles and bicycles in thermal images from above",
    size=(640, 512),
    channels=1,
    odds={"person": 0.45, "vehicle": 0.25, "bicycle": 0.30},
    augmentation=FROM_ABOVE,
)

DETECT_RGB = DetectorRecipe(
    name="detect-rgb",
    description="Persons, vehicles and bicycles in color images",
    size=(848, 480),
    channels=3,
    odds={"person": 0.45, "vehicle": 0.25, "bicycle": 0.30},
    augmentation=replace(AHEAD, zoom=(0.7, 1.5)),
    side=320,  # holds a near person whole: of 256 px most were cut off, and boxed loosely
    batch_size=6,
    slim=True,  # as segment-rgb's, with whose weights it can begin
)

#: By name.
DETECTORS = {recipe.name: recipe for recipe in (DETECT_THERMAL, DETECT_RGB)}
