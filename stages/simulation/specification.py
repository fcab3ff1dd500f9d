"""Sensors, rigs and presets as data: the YAML files beside this module, or a user's own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from pipeline.errors import DataError
from stages.calibration import parse_sensor
from stages.types import Calibration, Camera, SensorCalibration

_HERE = Path(__file__).parent
M = TypeVar("M", bound=BaseModel)

POSE = "pose"  #: the stream of poses among `Preset.rates_hz`


class _Spec(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Pinhole(_Spec):
    """A rectified camera."""

    size: tuple[int, int]  #: (width, height), pixels
    fx: float = Field(gt=0)
    fy: float = Field(gt=0)
    cx: float
    cy: float

    def scaled(self, scale: float) -> Camera:
        """The camera at a part of its resolution, about the pixels' edges."""
        width, height = (max(8, round(side * scale)) for side in self.size)
        x, y = width / self.size[0], height / self.size[1]
        return Camera(
            (width, height),
            self.fx * x,
            self.fy * y,
            (self.cx + 0.5) * x - 0.5,
            (self.cy + 0.5) * y - 0.5,
        )


class Stereo(_Spec):
    """Depth by stereo; see `stereo.py`."""

    baseline_m: float = Field(gt=0)
    noise_px: float = Field(ge=0)
    step_px: float = Field(gt=0)
    min_m: float = Field(gt=0)
    max_m: float = Field(gt=0)
    unit_m: float = Field(gt=0)


class RgbdSpec(_Spec):
    """An RGB camera with depth aligned to it."""

    kind: Literal["rgbd"]
    camera: Pinhole
    noise: float = Field(ge=0)
    depth: Stereo


class ThermalSpec(_Spec):
    """A thermal camera with 16 bit of 0.01 K."""

    kind: Literal["thermal"]
    camera: Pinhole
    netd_k: float = Field(ge=0)


class Fan(_Spec):
    """Evenly spaced beams from `first` to `last`, degrees above the horizon."""

    first: float
    last: float
    count: int = Field(ge=2)


class LidarSpec(_Spec):
    """A spinning LiDAR that turns clockwise from behind; see `lidar.py`."""

    kind: Literal["lidar"]
    columns: int = Field(ge=8)
    elevation_deg: Fan | list[Fan]
    min_m: float = Field(gt=0)
    max_m: float = Field(gt=0)
    full_m: float = Field(gt=0)
    noise_m: float = Field(ge=0)

    def elevations(self, scale: float = 1.0) -> NDArray[np.float64]:
        """(rows,) rad, from the top beam down."""
        fans = self.elevation_deg if isinstance(self.elevation_deg, list) else [self.elevation_deg]
        parts = [np.linspace(fan.first, fan.last, max(2, round(fan.count * scale))) for fan in fans]
        return np.radians(np.concatenate(parts))

    def azimuths(self, scale: float = 1.0) -> NDArray[np.float64]:
        """(columns,) rad counterclockwise from ahead, in the order of time."""
        columns = max(8, round(self.columns * scale))
        return np.pi - 2 * np.pi * (np.arange(columns) + 0.5) / columns


SensorSpec = Annotated[RgbdSpec | ThermalSpec | LidarSpec, Field(discriminator="kind")]
_SENSOR: TypeAdapter[RgbdSpec | ThermalSpec | LidarSpec] = TypeAdapter(SensorSpec)


class Mount(_Spec):
    """One sensor on the vehicle, and its clock."""

    use: str  #: a sensor that ships, or a YAML file beside the rig's
    base_from_sensor: Any  #: as in a graph file's calibration
    phase_ms: float = Field(0.0, ge=0)  #: of its first sample
    clock_offset_ms: float = 0.0  #: its stamps minus the true time
    delay_ms: float = Field(0.0, ge=0)  #: arrival after the end of the capture


class RigSpec(_Spec):
    """A vehicle and its sensors."""

    body: Literal["aircraft", "none"]
    sensors: dict[str, Mount]


class Preset(_Spec):
    """A simulated flight."""

    rig: str  #: a rig that ships, or a YAML file beside the preset's
    seed: int = Field(ge=0)
    duration_s: float = Field(gt=0, le=3600)
    speed_m_s: float = Field(gt=0, le=20)
    height_m: tuple[float, float]  #: least and greatest height of the base
    rates_hz: dict[str, Annotated[float, Field(gt=0, le=1000)]]  #: by sensor, and `pose`
    scale: float = Field(1.0, gt=0, le=1)  #: of every sensor's resolution
    pose_noise_m: float = Field(0.0, ge=0)  #: of the poses that the vehicle reports
    pose_noise_deg: float = Field(0.0, ge=0)
    site: Literal["district", "disaster"] = "district"
    #: How far one sees through dust, m; None: clear air. Every sensor's light is dimmed alike, as
    #: by particles that are coarse to all of them; the dust itself gives the LiDAR no returns.
    visibility_m: float | None = Field(None, gt=0)
    true_map: bool = True  #: whether to record the true map: of a long flight a third of the time


class Sensor(_Spec):
    """A sensor of a rig, ready to be simulated."""

    model_config = ConfigDict(frozen=True, arbitrary_types_allowed=True)

    name: str
    spec: RgbdSpec | ThermalSpec | LidarSpec
    mount: Mount
    calibration: SensorCalibration


class Rig(_Spec):
    """A rig with its files read."""

    model_config = ConfigDict(frozen=True, arbitrary_types_allowed=True)

    body: str
    sensors: dict[str, Sensor]

    def calibration(self) -> Calibration:
        """Where every sensor sits, with the camera models."""
        return Calibration({name: sensor.calibration for name, sensor in self.sensors.items()})


def preset_names() -> tuple[str, ...]:
    """The presets that ship."""
    return tuple(_read(_HERE / "presets.yaml"))


def load_preset(name: str) -> tuple[Preset, Path]:
    """A preset that ships, or that of a file (its path ends in .yaml), and its folder.

    Raises DataError with the place and the way out.
    """
    if Path(name).suffix in (".yaml", ".yml"):
        return _checked(Preset, _read(Path(name)), name), Path(name).parent
    shipped = _read(_HERE / "presets.yaml")
    if name not in shipped:
        raise DataError(
            f"no preset '{name}'; take one of {', '.join(shipped)}, or a file that ends in .yaml"
        )
    return _checked(Preset, shipped[name], f"presets.yaml: {name}"), _HERE


def load_rig(preset: Preset, folder: Path) -> Rig:
    """The rig of a preset at the preset's scale. Raises DataError."""
    file = _find(preset.rig, folder, "rigs")
    rig = _checked(RigSpec, _read(file), str(file))
    for name in preset.rates_hz:
        if name != POSE and name not in rig.sensors:
            raise DataError(
                f"rates_hz: rig '{preset.rig}' has no sensor '{name}' (it has "
                f"{', '.join(rig.sensors)}, and '{POSE}')"
            )
    sensors = {}
    for name, mount in rig.sensors.items():
        source = _find(mount.use, file.parent, "sensors")
        try:
            spec = _SENSOR.validate_python(_read(source))
            camera = None if isinstance(spec, LidarSpec) else spec.camera.scaled(preset.scale)
            placed = parse_sensor(name, {"base_from_sensor": mount.base_from_sensor})
        except ValidationError as error:
            raise DataError(f"{source}: {_first(error)}") from None
        except ValueError as error:
            raise DataError(f"{file}: sensors.{error}") from None
        calibration = SensorCalibration(placed.base_from_sensor, camera)
        sensors[name] = Sensor(name=name, spec=spec, mount=mount, calibration=calibration)
    return Rig(body=rig.body, sensors=sensors)


def _find(name: str, folder: Path, kind: str) -> Path:
    if Path(name).suffix in (".yaml", ".yml"):
        return folder / name
    file = _HERE / kind / f"{name}.yaml"
    if not file.exists():
        known = ", ".join(sorted(path.stem for path in (_HERE / kind).glob("*.yaml")))
        raise DataError(f"no {kind[:-1]} '{name}'; take one of {known}, or a file ending in .yaml")
    return file


def _read(path: Path) -> Mapping[str, Any]:
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(f"cannot read {path}: {error.strerror}") from error
    except yaml.YAMLError as error:
        raise DataError(f"{path}: not YAML ({error})") from error
    if not isinstance(content, Mapping):
        raise DataError(f"{path}: give keys and values, as the files in {_HERE.name}/ do")
    return content


def _checked(model: type[M], content: Mapping[str, Any], where: str) -> M:
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise DataError(f"{where}: {_first(error)}") from None


def _first(error: ValidationError) -> str:
    """The first mistake as ``key.key: what``."""
    mistake = error.errors()[0]
    return f"{'.'.join(map(str, mistake['loc']))}: {mistake['msg']}"
