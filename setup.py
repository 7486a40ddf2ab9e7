# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Build gtmr for colcon and for pip alike; name, version and licence stand in package.xml."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

manifest = ElementTree.parse("package.xml").getroot()
maintainer = manifest.find("maintainer")

nodes = ["sim", "nmpc", "monitor"]
shared = [
    *Path("config").rglob("*.*"),
    *Path("config").rglob("*.xml"),
    *Path("launch").glob("*.launch.py"),
    *Path("rviz").glob("*.*"),
]

setup(
    name=manifest.findtext("name"),
    version=manifest.findtext("version"),
    description=manifest.findtext("description").strip(),
    license=manifest.findtext("license"),
    maintainer=maintainer.text,
    maintainer_email=maintainer.get("email"),
    package_dir={"": "src"},
    packages=find_packages("src"),
    # config/ reaches the wheel through the link src/gtmr_model/config.
    package_data={
        "": ["py.typed"],
        "gtmr_model": ["config/**/*.*"],
        "gtmr_guard": ["c/*.[ch]"],
        "gtmr_monitor.report": ["page.css", "page.js"],
        "gtmr_msgs_py.start": ["*.xml"],
        "gtmr_nmpc.compiled": ["c/*.[ch]"],
        "gtmr_sim.loop": ["c/*.[ch]"],
        "gtmr_study.arena": ["arena.js"],
        "gtmr_study.export": ["replay.c", "CMakeLists.txt"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/gtmr"]),
        ("share/gtmr", ["package.xml"]),
        # `ros2 run` looks into lib/gtmr, where pip puts no console script.
        ("lib/gtmr", [f"scripts/{node}" for node in nodes]),
        *((f"share/gtmr/{path.parent}", [str(path)]) for path in sorted(shared)),
    ],
    entry_points={"console_scripts": ["gtmr = gtmr_study.cli:main"]},
    python_requires=">=3.10",
    # What the three nodes and the recorded bags need: a robot installs no more.
    install_requires=[
        "casadi>=3.6.5",
        "daqp",
        "mcap",
        "numpy>=1.26",
        "pydantic>=2.10",
        "pyyaml",
        "rosbags>=0.11",
        "scipy",
        "zstandard",
    ],
    extras_require={
        # Apart from the rest, because beside an installed ROS 2 it would shadow its rclpy.
        "ros": ["ros-common-interfaces==5.3.6", "ros-rclpy[fastrtps]==7.1.6"],
        # The command line: flights, campaigns, reports.
        "study": ["dask", "distributed", "matplotlib", "pandas", "plotly", "rich", "typer"],
        "live": ["viser"],
        "calibrate": ["cmaes>=0.11", "optuna"],
        # The arena as an environment to learn in.
        "gym": ["gymnasium>=1.0"],
        # The site.
        "docs": ["myst-parser", "numpydoc", "pydata-sphinx-theme", "sphinx"],
        "test": ["gymnasium>=1.0", "hypothesis", "piqp", "pytest", "pytest-xdist"],
        "dev": [
            "colcon-bash",
            "colcon-output",
            "colcon-package-information",
            "colcon-package-selection",
            "colcon-ros",
            "import-linter",
            "mypy",
            "ruff",
            "types-PyYAML",
            "wheel",
        ],
    },
)
