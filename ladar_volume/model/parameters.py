"""The parameters of every stage. This file is the only source of a default, a unit, a bound or a
help text.

Sigmas are one standard deviation. Defaults are a VLP-16 with an RTK receiver and a tactical-grade
attitude source.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from ladar_volume.model.cloud_filter_parameters import FilterParameters as FilterParameters
from ladar_volume.model.mavlink_parameters import MavlinkParameters
from ladar_volume.model.parameter import param, read_section, unknown_section, write_section
from ladar_volume.model.robust_fit_parameters import RandomStartParameters
from ladar_volume.model.surface_parameters import TinParameters
from ladar_volume.model.volume_parameters import VolumeParameters as VolumeParameters


@dataclass(frozen=True)
class CalibrationParameters:
    """Where the sensors sit: the LiDAR equation's constants."""

    boresight_roll_rad: float = param(
        0.0,
        "Nominal boresight roll of R_body_laser = Rz(yaw) Ry(pitch) Rx(roll).",
        low=-360,
        high=360,
    )
    boresight_pitch_rad: float = param(0.0, "Nominal boresight pitch.", low=-360, high=360)
    boresight_yaw_rad: float = param(0.0, "Nominal boresight yaw.", low=-360, high=360)
    boresight_correction_rad: tuple[float, ...] = param(
        (0.0, 0.0, 0.0),
        "Small body-side rotation vector applied to the nominal boresight.",
        low=-10,
        high=10,
        vector=3,
    )
    lever_laser_m: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), "Laser origin in the body frame, b.", unit="m", low=-50, high=50, vector=3
    )
    lever_antenna_m: tuple[float, ...] = param(
        (0.0, 0.0, 0.0),
        "Antenna phase centre in the body frame, a.",
        unit="m",
        low=-50,
        high=50,
        vector=3,
    )
    clock_offset_s: float = param(
        0.0,
        "dt: navigation time minus LiDAR time, t_nav = t_lidar + dt.",
        unit="s",
        low=-1e5,
        high=1e5,
    )


@dataclass(frozen=True)
class BudgetParameters:
    """The error budget: what is not known of sensor, navigation and calibration."""

    range_noise_m: float = param(0.010, "Range noise of one return.", unit="m", low=0, high=1)
    azimuth_noise_rad: float = param(
        math.radians(0.01), "Azimuth noise of one return.", low=0, high=5
    )
    vertical_noise_rad: float = param(
        math.radians(0.01), "Vertical angle noise of one return.", low=0, high=5
    )
    beam_divergence_rad: float = param(
        0.0015,
        (
            "Full beam divergence; a quarter of it acts as angular noise, so range noise "
            "grows with incidence."
        ),
        low=0,
        high=5,
    )
    beam_range_sigma_m: float = param(
        0.004, "Range offset of each beam, constant per beam (rho_k).", unit="m", low=0, high=1
    )
    beam_vertical_sigma_rad: float = param(
        math.radians(0.01), "Vertical angle offset of each beam, constant (eps_k).", low=0, high=5
    )
    range_bias_sigma_m: float = param(
        0.003, "Range bias common to all beams (rho_0).", unit="m", low=0, high=1
    )
    position_sigma_m: tuple[float, ...] = param(
        (0.014, 0.014, 0.021),
        "Antenna position east, north, up: stands in where the receiver gives no covariance.",
        unit="m",
        low=0,
        high=100,
        vector=3,
    )
    attitude_sigma_rad: tuple[float, ...] = param(
        (math.radians(0.02), math.radians(0.02), math.radians(0.05)),
        "Roll, pitch, heading: stands in where the IMU gives no covariance.",
        low=0,
        high=90,
        vector=3,
    )
    position_bias_fraction: float = param(
        0.2, "Share of the position variance that is constant over the survey.", low=0, high=1
    )
    position_white_fraction: float = param(
        0.1,
        "Share of the position variance that is white per fix; the rest is Gauss-Markov.",
        low=0,
        high=1,
    )
    attitude_bias_fraction: float = param(
        0.1, "Share of the attitude variance that is constant over the survey.", low=0, high=1
    )
    attitude_white_fraction: float = param(
        0.1,
        "Share of the attitude variance that is white per sample; the rest is Gauss-Markov.",
        low=0,
        high=1,
    )
    tau_position_s: float = param(
        300.0, "Correlation time of the position's Gauss-Markov part.", unit="s", low=0.1, high=1e6
    )
    tau_attitude_s: float = param(
        20.0, "Correlation time of the attitude's Gauss-Markov part.", unit="s", low=0.1, high=1e6
    )
    boresight_sigma_rad: tuple[float, ...] = param(
        (math.radians(0.02), math.radians(0.02), math.radians(0.04)),
        "Boresight, body rotation vector.",
        low=0,
        high=10,
        vector=3,
    )
    lever_laser_sigma_m: tuple[float, ...] = param(
        (0.002, 0.002, 0.003), "Laser lever arm.", unit="m", low=0, high=10, vector=3
    )
    lever_antenna_sigma_m: tuple[float, ...] = param(
        (0.002, 0.002, 0.003), "Antenna lever arm.", unit="m", low=0, high=10, vector=3
    )
    clock_sigma_s: float = param(0.0002, "Clock offset.", unit="s", low=0, high=100)
    calibration_correlation: tuple[float, ...] = param(
        (),
        "Correlations of the calibration errors, as `calibrate strips` writes them: "
        "upper triangle, row by row, over range bias, "
        "boresight, laser lever arm, antenna lever arm (x, y, z each), clock, and where "
        "given all beams' range and vertical offsets; "
        "empty for none.",
        low=-1,
        high=1,
        vector=0,
    )


@dataclass(frozen=True)
class GeoreferenceParameters:
    """Trajectory and the selection of returns."""

    pose_source: str = param("gnss_imu", "Where poses come from.", choices=("gnss_imu", "odometry"))
    position_interpolation: str = param(
        "parabola",
        "Antenna position between fixes: on a chord; on the parabola through both and the fix "
        "before; or cubic, for which a return waits for one fix more.",
        choices=("linear", "parabola", "hermite"),
    )
    max_position_gap_s: float = param(
        0.6,
        "Largest interval between fixes that is bridged; returns in a longer one are lost.",
        unit="s",
        low=0.001,
        high=60,
    )
    max_attitude_gap_s: float = param(
        0.15, "Largest interval between attitudes that is bridged.", unit="s", low=0.001, high=60
    )
    unknown_covariance: str = param(
        "refuse",
        "Fix or attitude without covariance: refuse it, or take the budget's sigma.",
        choices=("refuse", "budget"),
    )
    stamp_refers_to: str = param(
        "first",
        "What the stamp marks where `t` offsets count from the sweep's start.",
        choices=("first", "last"),
    )
    untimed_clouds: str = param(
        "refuse",
        "Cloud without per-point time: refuse it, or give every return the stamp.",
        choices=("refuse", "stamp"),
    )
    range_min_m: float = param(0.5, "Nearest range kept.", unit="m", low=0, high=1000)
    range_max_m: float = param(120.0, "Farthest range kept.", unit="m", low=0.1, high=10000)
    vehicle_box_m: tuple[float, ...] = param(
        (),
        "Own-vehicle mask in the body frame: xmin, ymin, zmin, xmax, ymax, zmax; empty for none.",
        unit="m",
        vector=0,
    )
    region_m: tuple[float, ...] = param(
        (),
        "Region of interest in the map frame, as vehicle_box_m; empty for all.",
        unit="m",
        vector=0,
    )
    intensity_min: float = param(0.0, "Lowest intensity kept.", low=0)
    intensity_max: float = param(math.inf, "Highest intensity kept.", low=0)
    beams: int = param(16, "Number of beams of the scanner.", low=1, high=128)
    datum_latitude_deg: float = param(
        math.nan, "Latitude of the datum; NaN for the first fix.", unit="deg", low=-90, high=90
    )
    datum_longitude_deg: float = param(
        math.nan, "Longitude of the datum.", unit="deg", low=-180, high=180
    )
    datum_height_m: float = param(
        math.nan, "Ellipsoidal height of the datum.", unit="m", low=-1000, high=10000
    )
    max_pending_s: float = param(
        5.0,
        "How long returns wait for the trajectory before they are lost.",
        unit="s",
        low=0.1,
        high=600,
    )
    mounting_from_tf: bool = param(
        True,
        "Take boresight and lever arms that `calibration` has at zero from /tf_static, and refuse "
        "others that contradict it.",
    )
    covariance_output: str = param(
        "independent",
        "What the covariance fields of points_mapped hold.",
        choices=("independent", "total"),
    )


@dataclass(frozen=True)
class SurfaceFilterParameters(RandomStartParameters):
    """Robust moving least squares on a stream (seed 002 chapter 4)."""

    elsewhere: ClassVar[dict[str, str]] = dict.fromkeys(
        (
            *("order", "confidence", "grid_before_m", "grid_after_m", "reduce", "edge"),
            *("edges_threshold", "min_share", "sort"),
        ),
        "is read for point cloud files alone, by `ladar_volume filter --set` with the same name: "
        "take it out here",
    )

    cap_per_voxel: int = param(
        32,
        "Most raw points kept per voxel of edge r (those with the lowest hashes).",
        low=1,
        high=100000,
    )
    sampling_m: float = param(
        0.0, "Spacing of the filtered points; 0 for r / 2.", unit="m", low=0, high=100
    )
    nav_bin_s: float = param(
        2.0,
        "Length of a navigation time bin of the mean sensitivities.",
        unit="s",
        low=0.01,
        high=60,
    )


@dataclass(frozen=True)
class GroundParameters:
    """The ground fitted to the surroundings (seed 002 chapter 6)."""

    trials: int = param(1000, "RANSAC trials (thesis: 1000).", low=1, high=1000000)
    sample_size: int = param(
        0,
        "Points per random sample; 0 for the fewest that define the surface "
        "(thesis: k = 20 or 10).",
        low=0,
        high=1000,
    )
    threshold_m: float = param(
        0.0, "Inlier threshold; 0 for 3.5 robust sigma of the residuals.", unit="m", low=0, high=10
    )
    below_weight: float = param(
        4.0,
        "How much a point below a candidate counts against it: 0 for the largest surface "
        "(thesis); with w a surface above the ground wins "
        "only with more than 1 + w times its points.",
        low=0,
        high=100,
    )
    max_tilt_rad: float = param(
        math.radians(30.0), "Largest tilt of the ground from the horizontal.", low=0, high=89
    )
    degree: int = param(
        1, "Degree of the ground polynomial: 0 level, 1 plane, 2 quadric, 3 cubic.", low=0, high=3
    )
    surfaces: int = param(
        1,
        "Most ground surfaces (terraces, steps); the volume stands on the first.",
        low=1,
        high=1000,
    )
    min_support: float = param(
        0.02, "Smallest share of the points that makes a ground surface.", low=0, high=1
    )
    seed: int = param(1, "Seed of the random samples.", low=0, high=2**31 - 1)


@dataclass(frozen=True)
class NodeParameters:
    """What the nodes need beside their stage."""

    update_period_s: float = param(
        0.1, "Pause between two updates of the filtered surface.", unit="s", low=0.05, high=60
    )
    map_period_s: float = param(
        5.0, "How often tin and mesh are published, at most.", unit="s", low=0.05, high=600
    )
    check_period_s: float = param(
        2.0,
        "How often, at most, a live survey checks passes, ground and the edges of its bodies anew; "
        "until then the last findings count. The last volume, and one asked for, is checked whole.",
        unit="s",
        low=0.0,
        high=600,
    )
    cloud_message: str = param(
        "PointCloud2",
        "What the scanner's driver publishes: clouds on velodyne_points, or the packets of a "
        "Velodyne (velodyne_msgs) on velodyne_packets.",
        choices=("PointCloud2", "VelodyneScan"),
    )
    odometry_message: str = param(
        "Odometry",
        "Where poses come from with georeference.pose_source odometry: the topic odometry, or the "
        "transforms from map_frame to base_frame on /tf.",
        choices=("Odometry", "TFMessage"),
    )
    input_reliability: str = param(
        "best_effort",
        "Reliability of the sensor subscriptions.",
        choices=("best_effort", "reliable"),
    )
    input_depth: int = param(
        500,
        "History depth of the sensor subscriptions; a longer burst overwrites its beginning.",
        low=1,
        high=10000,
    )
    diagnostics_period_s: float = param(
        1.0, "How often /diagnostics is published.", unit="s", low=0.1, high=60
    )
    autostart: bool = param(True, "Configure and activate at start.")
    tin_colour: str = param("height", "Colour of the published TIN.", choices=("height", "sigma"))
    output_folder: str = param("out", "Where ~/save writes.")
    hardware_id: str = param("", "Name of the vehicle in /diagnostics; empty: the computer's.")
    lidar_frame: str = param(
        "", "Frame the clouds must come in; empty: any in which a scanner can measure."
    )
    imu_frame: str = param("", "Frame the attitudes must come in; empty: any.")
    gnss_frame: str = param("", "Frame the fixes must come in; empty: any.")
    map_frame: str = param("map", "Frame of the map (REP-105); another one for each vehicle.")
    odom_frame: str = param("odom", "Frame between map and base_frame on /tf; empty: none.")
    base_frame: str = param("base_link", "Frame of the platform, whose pose is published.")
    publish_tf: str = param(
        "pose",
        "What goes to /tf where tf2_msgs is installed: pose (odom to base_frame, with map to odom "
        "fixed), correction (map to odom, where another node publishes odom to base_frame), off.",
        choices=("pose", "correction", "off"),
    )


@dataclass(frozen=True)
class LoggerParameters:
    """The MCAP log."""

    path: str = param(
        "ladar_volume.mcap",
        "File to write; further files get a running number, an existing one is never overwritten.",
    )
    topics: tuple[str, ...] = param(
        ("*",),
        "Topics to log, with shell wildcards; '*' for the inputs and results of this vehicle.",
        vector=0,
    )
    all: bool = param(
        False,
        (
            "With '*', log also what the nodes derive on the way (mapped and filtered points, "
            "patches, tin, mesh): many times the size of the inputs, and a replay makes it again."
        ),
    )
    chunk_s: float = param(
        0.5,
        (
            "Longest time before a chunk is written; a killed logger loses this and what it "
            "was writing."
        ),
        unit="s",
        low=0.05,
        high=1,
    )
    chunk_bytes: int = param(4_000_000, "Largest chunk.", unit="B", low=1000, high=2**31 - 1)
    compression: str = param("zstd", "Chunk compression.", choices=("zstd", "lz4", "none"))
    sync: str = param(
        "chunk",
        (
            "What the disk is asked to confirm: every chunk, against power cuts, or nothing; "
            "a killed process needs neither."
        ),
        choices=("chunk", "never"),
    )
    split_bytes: int = param(0, "Start a new file beyond this size; 0 for never.", unit="B", low=0)
    split_s: float = param(
        0.0, "Start a new file after this time; 0 for never.", unit="s", low=0, high=1e6
    )
    queue_bytes: int = param(
        64_000_000,
        (
            "Most bytes that wait for a slow disk, six seconds at full rate; beyond, the "
            "newest message is dropped and counted."
        ),
        unit="B",
        low=1_000_000,
    )
    disk_reserve_bytes: int = param(
        200_000_000, "The disk counts as full when less than this is free.", unit="B", low=0
    )
    disk_full: str = param(
        "stop",
        (
            "On a full disk: finish the file and wait for space, or delete the oldest "
            "finished file of this log."
        ),
        choices=("stop", "delete_oldest"),
    )


SECTIONS: dict[str, type] = {
    "calibration": CalibrationParameters,
    "budget": BudgetParameters,
    "georeference": GeoreferenceParameters,
    "filter": SurfaceFilterParameters,
    "ground": GroundParameters,
    "tin": TinParameters,
    "volume": VolumeParameters,
    "node": NodeParameters,
    "logger": LoggerParameters,
    "mavlink": MavlinkParameters,
}


@dataclass(frozen=True)
class Parameters:
    """All stages. ``read`` and ``write`` are inverse to each other."""

    calibration: CalibrationParameters = field(default_factory=CalibrationParameters)
    budget: BudgetParameters = field(default_factory=BudgetParameters)
    georeference: GeoreferenceParameters = field(default_factory=GeoreferenceParameters)
    filter: SurfaceFilterParameters = field(default_factory=SurfaceFilterParameters)
    ground: GroundParameters = field(default_factory=GroundParameters)
    tin: TinParameters = field(default_factory=TinParameters)
    volume: VolumeParameters = field(default_factory=VolumeParameters)
    node: NodeParameters = field(default_factory=NodeParameters)
    logger: LoggerParameters = field(default_factory=LoggerParameters)
    mavlink: MavlinkParameters = field(default_factory=MavlinkParameters)

    @classmethod
    def read(
        cls,
        mapping: Mapping[str, Mapping[str, Any]],
        start: Parameters | None = None,
        old: bool = False,
    ) -> Parameters:
        """From ``{section: {key: value}}`` on top of ``start``; raises a ConfigurationError naming
        key, value and range. old : what an earlier version wrote; keys that its algorithm did not
        read and that are elsewhere now are passed over.
        """
        base = start if start is not None else cls()
        changes = {}
        for section, values in mapping.items():
            if section not in SECTIONS:
                raise unknown_section(str(section), list(SECTIONS))
            kind, given = SECTIONS[section], values or {}
            if old:
                given = {k: v for k, v in given.items() if k not in getattr(kind, "elsewhere", {})}
            changes[section] = read_section(kind, section, given, getattr(base, section))
        return dataclasses.replace(base, **changes)

    def checked(self) -> Parameters:
        """These, where each has its effect beside the others; raises a ConfigurationError."""
        self.tin.check(self.volume.vertex_ratio, self.volume.relevant)
        self.volume.check()
        return self

    def write(self) -> dict[str, dict[str, Any]]:
        """As ``{section: {key: value}}`` with outside keys and units."""
        return {section: write_section(getattr(self, section)) for section in SECTIONS}
