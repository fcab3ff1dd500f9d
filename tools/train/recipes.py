"""What each network is trained for: its input, its classes, and what was found to serve it best."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

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

    @property
    def color(self) -> str:
        """The channel order, in the registry's words."""
        return "gray" if self.channels == 1 else "rgb"

    @property
    def class_map(self) -> Mapping[int, str]:
        """The network's classes as ours."""
        return dict(enumerate(self.odds))


DETECT_THERMAL = DetectorRecipe(
    name="detect-thermal",
    description="Persons, vehicles and bicycles in thermal images from above",
    size=(640, 512),
    channels=1,
    odds={"person": 0.45, "vehicle": 0.25, "bicycle": 0.30},
)

DETECT_RGB = DetectorRecipe(
    name="detect-rgb",
    description="Persons, vehicles and bicycles in color images",
    size=(848, 480),
    channels=3,
    odds={"person": 0.45, "vehicle": 0.25, "bicycle": 0.30},
    # A color camera looks ahead: what is upside down or lies on its side is none of these.
    augmentation=Augmentation(upside_down=0.0, quarter_turn=0.0),
)
