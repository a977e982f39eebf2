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
#: What the verbs on files and recordings need, from the versions of Ubuntu 24.04 on. Versions that
#: are tested are in requirements.txt; test/test_installation.py holds the two together.
NEEDED = (
    "numpy>=1.26",
    "scipy>=1.11",
    "numba>=0.61",
    "pyproj>=3.6",
    "laspy[lazrs]>=2.5",
    "rosbags>=0.11",
    "mcap>=1.2",
    "zstandard>=0.22",
    "matplotlib>=3.6",
    "rich>=13",
    "PyYAML>=6.0",
    "jinja2>=3.1",
)
#: What more is for: the nodes, an autopilot's poses, simulated surveys, the page in the field.
EXTRAS = {
    "ros": ["ros-jazzy-rclpy[fastrtps]>=7.1,<7.2", "ros-jazzy-common-interfaces>=5.3,<5.4"],
    "mavlink": ["pymavlink>=2.4.42"],
    "sim": [
        "open3d-cpu>=0.19; platform_machine == 'x86_64' and sys_platform == 'linux'",
        "open3d>=0.19; platform_machine != 'x86_64' or sys_platform != 'linux'",
    ],
    # files of CAD and GIS; coordinate systems are among NEEDED
    "geo": [
        "rasterio>=1.3",
        "ezdxf>=1.1",
        "pye57>=0.4.1; platform_machine == 'x86_64'",
        "pyogrio>=0.7",
        "shapely>=2.0",
    ],
    "frames": ["geopandas>=1.0", "xarray>=2024.1"],  # answers as their tables and rasters
    "page": ["starlette>=0.40", "uvicorn>=0.30"],
    "foxglove": ["foxglove-sdk>=0.30"],  # `up --foxglove`
    "scale": ["dask>=2024.1", "distributed>=2024.1", "pyarrow>=15"],
    "completion": ["shtab>=1.7"],
    "velodyne": ["velodyne-decoder>=3.1"],  # packets: VelodyneScan and captures
    "test": ["pytest"],  # by this colcon knows that pytest runs the tests
}


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
    package_data={
        PACKAGE: ["py.typed", "process/fastdds.xml", "report/report.html.j2", "page/page.html"]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/launch", sorted(glob("launch/*.launch.py"))),
        (f"share/{PACKAGE}/config", sorted(glob("config/*.*"))),
    ],
    python_requires=">=3.11, <3.14",
    install_requires=NEEDED,
    extras_require=EXTRAS,
    zip_safe=True,
    entry_points={
        "console_scripts": [
            "ladar_volume = ladar_volume.cli.main:main",
            *(f"{node} = ladar_volume.nodes.programs:{node}" for node in NODES),
        ],
    },
)
