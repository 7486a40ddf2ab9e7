# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What Lichtblick 1.28.1 reads of a layout, as far as ours uses it.

Of https://github.com/lichtblick-suite/lichtblick, below ``packages/suite-base/src``: the title's
key in ``util/layout.ts``, and each panel's configuration in ``panels/Plot/utils/config.ts``,
``panels/Gauge/types.ts`` and ``panels/ThreeDeeRender/`` (``IRenderer.ts``, ``settings.ts``,
``camera.ts``, ``renderables/``). Foxglove has the title under a key of its own.
"""

import json
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

Vector = tuple[float, float, float]
Colour = Annotated[str, Field(pattern=r"^#([0-9a-fA-F]{6}|[0-9a-fA-F]{8})$")]


class Strict(BaseModel):
    """Has no other keys, and no value of another type."""

    model_config = ConfigDict(extra="forbid", strict=True)


class Panel(Strict):
    foxglovePanelTitle: str
    lichtblickPanelTitle: str


class PlotPath(Strict):
    value: str
    enabled: bool
    label: str
    color: Colour
    timestampMethod: Literal["receiveTime", "headerStamp"]
    showLine: Literal[True]
    lineSize: Annotated[float, Field(gt=0.0, le=3.0)]


class Plot(Panel):
    """There is also ``followingViewWidth``: with it the curves of a recorded bag stay empty."""

    paths: list[PlotPath]
    minYValue: float | None = None
    maxYValue: float | None = None
    showLegend: bool
    legendDisplay: Literal["left", "none"]
    """The others, ``floating`` and ``top``, cover curves, or all entries but the first."""
    showPlotValuesInLegend: bool
    showXAxisLabels: bool
    showYAxisLabels: bool
    isSynced: bool
    xAxisVal: Literal["timestamp", "index", "custom", "currentCustom"]
    xAxisLabel: str
    yAxisLabel: str
    sidebarDimension: int


class Gauge(Panel):
    path: str
    minValue: float
    maxValue: float
    colorMap: Literal["red-yellow-green", "rainbow", "turbo"]
    colorMode: Literal["colormap", "gradient"]
    gradient: tuple[Colour, Colour]
    reverse: bool


class Camera(Strict):
    perspective: bool
    distance: float
    phi: float
    thetaOffset: float
    targetOffset: Vector
    target: Vector
    targetOrientation: tuple[float, float, float, float]
    fovy: float
    near: float
    far: float


class Transforms(Strict):
    enablePreloading: Literal[False]
    """Stamps are of simulated time: read ahead, the last of them would hold throughout."""
    showLabel: bool
    axisScale: float
    lineWidth: float


class Scene(Strict):
    backgroundColor: Colour
    mainLightMode: Literal["fixed", "headlight"]
    transforms: Transforms


class Visible(Strict):
    visible: bool


class Markers(Visible):
    showOutlines: Literal[False]
    namespaces: dict[str, Visible]


class Path(Visible):
    type: Literal["axis", "arrow", "line"]
    lineWidth: float
    gradient: tuple[Colour, Colour]


class Grid(Visible):
    layerId: Literal["foxglove.Grid"]
    instanceId: str
    label: str
    frameId: str
    size: float
    divisions: int
    lineWidth: float
    color: Colour
    position: Vector
    rotation: Vector
    order: int


class Publish(Strict):
    type: Literal["point", "pose", "pose_estimate"]
    poseTopic: str
    pointTopic: str
    poseEstimateTopic: str
    poseEstimateXDeviation: float
    poseEstimateYDeviation: float
    poseEstimateThetaDeviation: float


class ThreeDee(Panel):
    cameraState: Camera
    followTf: str
    followMode: Literal["follow-pose", "follow-position", "follow-none"]
    scene: Scene
    publish: Publish
    transforms: dict[str, Visible]
    topics: dict[str, Markers | Path]
    layers: dict[str, Grid]
    imageMode: Annotated[dict[str, bool], Field(max_length=0)]


class Split(Strict):
    direction: Literal["row", "column"]
    first: "str | Split"
    second: "str | Split"
    splitPercentage: Annotated[float, Field(gt=0.0, lt=100.0)]


class Playback(Strict):
    speed: float


class Layout(Strict):
    """A whole file."""

    configById: dict[str, dict[str, Any]]
    globalVariables: Annotated[dict[str, str], Field(max_length=0)]
    userNodes: Annotated[dict[str, str], Field(max_length=0)]
    playbackConfig: Playback
    layout: Split


PANELS: dict[str, type[Panel]] = {"3D": ThreeDee, "Plot": Plot, "Gauge": Gauge}
"""By what a panel's key begins with, up to an exclamation mark."""


def read_layout(text: str) -> dict[str, Panel]:
    """Read a layout's panels by their key; ValidationError tells what no viewer would read."""
    layout = Layout.model_validate_json(text)
    return {
        # As JSON again: there an array is a tuple, which a list of Python strictly is not.
        key: PANELS[key.partition("!")[0]].model_validate_json(json.dumps(config))
        for key, config in layout.configById.items()
    }
