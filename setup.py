"""Install the package and make the prefix an ament prefix (resource index, package.xml, launch,
config).
"""

from glob import glob
from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

PACKAGE = "ladar_volume"
MANIFEST = ElementTree.parse(Path(__file__).parent / "package.xml").getroot()
NODES = ("georeference_node", "filter_node", "volume_node", "logger_node", "mavlink_node", "player")


def manifest(tag: str) -> str:
    """Text of a tag of package.xml, the one source of name, version and description."""
    return str(MANIFEST.findtext(tag)).strip()


setup(
    name=PACKAGE,
    version=manifest("version"),
    description=manifest("description"),
    license=manifest("license"),
    maintainer=manifest("maintainer"),
    maintainer_email=MANIFEST.find("maintainer").attrib["email"],
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed", "process/fastdds.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/launch", sorted(glob("launch/*.launch.py"))),
        (f"share/{PACKAGE}/config", sorted(glob("config/*.yaml") + glob("config/*.json"))),
    ],
    python_requires=">=3.11, <3.14",
    extras_require={"test": ["pytest"]},  # by this colcon knows that pytest runs the tests
    zip_safe=True,
    entry_points={
        "console_scripts": [
            "ladar_volume = ladar_volume.cli.main:main",
            *(f"{node} = ladar_volume.nodes.programs:{node}" for node in NODES),
        ],
    },
)
