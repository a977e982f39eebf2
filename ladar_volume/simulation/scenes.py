"""Scenes with closed-form volumes, as triangle meshes for ray casting.

A body stands on its own ground: its surface is ``ground(x, y) + h(x, y)`` meshed with the ground's
own vertices, so the volume is the integral of h whatever the ground does. Meshes approximate
circles by 1,440-gons (3e-6 of the volume).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.special import j1

from ladar_volume.model.errors import SimulationError

F64 = npt.NDArray[np.float64]
I32 = npt.NDArray[np.int32]
Height = Callable[[F64, F64], F64]
SIDES = 1440
REPOSE = np.radians(35.0)


@dataclass(frozen=True)
class Scene:
    """Vertices (n, 3) m, triangles (m, 3), exact volume of the body above its own ground, a
    suggested outline (k, 2) m and the radius of the part of the scene that matters.

    ``platforms`` see enough of the body: a scanner on a low mast sees neither the top of a high
    pile nor the floor of a pit. ``flight_m`` is half the length of a flight and its height;
    ``loop_m`` the rover's loop: radius, centre x, y, and +1 with the body inside the loop or −1
    with the body outside. What is not given follows from the extent. ``extra`` goes into the truth.
    """

    name: str
    vertices: F64
    triangles: I32
    volume_m3: float
    outline: F64
    extent_m: float
    extra: dict[str, float] = field(default_factory=dict)
    platforms: tuple[str, ...] = ("uav",)
    flight_m: tuple[float, float] | None = None
    loop_m: tuple[float, float, float, float] | None = None


@dataclass(frozen=True)
class Ground:
    """``z = height + slope·(x, y) + roughness``: a sum of sinusoids of zero mean with sd
    ``rough_m`` and correlation length about ``length_m``.
    """

    height_m: float = 0.0
    slope: tuple[float, float] = (0.0, 0.0)
    rough_m: float = 0.0
    length_m: float = 1.0
    seed: int = 0

    def waves(self) -> tuple[F64, F64, F64]:
        """Wave vectors (k, 2), phases (k,), amplitudes (k,)."""
        rng = np.random.default_rng(self.seed)
        count = 40
        k = rng.normal(0.0, 1.0 / self.length_m, (count, 2))
        return (
            k,
            rng.uniform(0, 2 * np.pi, count),
            np.full(count, self.rough_m * np.sqrt(2.0 / count)),
        )

    def __call__(self, x: F64, y: F64) -> F64:
        """Height at (x, y)."""
        z: F64 = self.height_m + self.slope[0] * x + self.slope[1] * y
        if self.rough_m > 0:
            k, phase, amplitude = self.waves()
            for (kx, ky), p, a in zip(k, phase, amplitude, strict=True):
                z = z + a * np.sin(kx * x + ky * y + p)
        return z

    def mean_over_box(self, x0: float, x1: float, y0: float, y1: float) -> float:
        """Exact mean height over a rectangle."""
        cx, cy = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
        total = self.height_m + self.slope[0] * cx + self.slope[1] * cy
        if self.rough_m > 0:
            k, phase, amplitude = self.waves()
            half = 0.5 * np.array([x1 - x0, y1 - y0])
            shrink = np.sinc(k[:, 0] * half[0] / np.pi) * np.sinc(k[:, 1] * half[1] / np.pi)
            total += float(np.sum(amplitude * shrink * np.sin(k[:, 0] * cx + k[:, 1] * cy + phase)))
        return total

    def mean_over_disc(self, cx: float, cy: float, radius: float) -> float:
        """Exact mean height over a disc: a wave shrinks by ``2 J1(k r) / (k r)``."""
        total = self.height_m + self.slope[0] * cx + self.slope[1] * cy
        if self.rough_m > 0:
            k, phase, amplitude = self.waves()
            kr = np.hypot(k[:, 0], k[:, 1]) * radius
            total += float(
                np.sum(amplitude * 2 * j1(kr) / kr * np.sin(k[:, 0] * cx + k[:, 1] * cy + phase))
            )
        return total


def grid_mesh(x: F64, y: F64, height: Height) -> tuple[F64, I32]:
    """A rectangular grid of triangles."""
    gx, gy = np.meshgrid(x, y, indexing="ij")
    vertices = np.column_stack([gx.ravel(), gy.ravel(), height(gx.ravel(), gy.ravel())])
    i = (np.arange(len(x) - 1)[:, None] * len(y) + np.arange(len(y) - 1)[None, :]).ravel()
    n = len(y)
    triangles = np.concatenate(
        [np.column_stack([i, i + n, i + n + 1]), np.column_stack([i, i + n + 1, i + 1])]
    )
    return vertices, triangles.astype(np.int32)


def polar_mesh(
    rho: F64, a: float, b: float, profile: Callable[[F64], F64], ground: Height
) -> tuple[F64, I32]:
    """Rings at elliptic radii rho (rho = 1 is the ellipse with semi-axes a, b) with a common centre
    vertex.
    """
    phi = 2 * np.pi * np.arange(SIDES) / SIDES
    x = np.concatenate([[0.0], (rho[:, None] * a * np.cos(phi)).ravel()])
    y = np.concatenate([[0.0], (rho[:, None] * b * np.sin(phi)).ravel()])
    h = np.concatenate([profile(np.zeros(1)), np.repeat(profile(rho), SIDES)])
    vertices = np.column_stack([x, y, ground(x, y) + h])
    k = np.arange(SIDES)
    nxt = (k + 1) % SIDES
    parts = [np.column_stack([np.zeros(SIDES, int), 1 + k, 1 + nxt])]
    for ring in range(len(rho) - 1):
        lo, hi = 1 + ring * SIDES, 1 + (ring + 1) * SIDES
        parts += [
            np.column_stack([lo + k, hi + k, hi + nxt]),
            np.column_stack([lo + k, hi + nxt, lo + nxt]),
        ]
    return vertices, np.concatenate(parts).astype(np.int32)


def box_mesh(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float) -> tuple[F64, I32]:
    """A closed box."""
    v = np.array([[x, y, z] for z in (z0, z1) for y in (y0, y1) for x in (x0, x1)])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    t = [q for a, b, c, d in quads for q in ((a, b, c), (a, c, d))]
    return v, np.array(t, np.int32)


def join(*meshes: tuple[F64, I32]) -> tuple[F64, I32]:
    """One mesh of several."""
    vertices, triangles, offset = [], [], 0
    for v, t in meshes:
        vertices.append(v)
        triangles.append(t + offset)
        offset += len(v)
    return np.concatenate(vertices), np.concatenate(triangles).astype(np.int32)


def _ring_outline(a: float, b: float, margin: float) -> F64:
    phi = 2 * np.pi * np.arange(48) / 48
    return np.column_stack([(a + margin) * np.cos(phi), (b + margin) * np.sin(phi)])


def pile(name: str, a: float, b: float, top: float, ground: Ground, extent: float = 45.0) -> Scene:
    """An elliptic pile with semi-axes a, b (m) at the toe, angle of repose along the minor axis,
    cut off at the relative radius ``top`` (0: cone). Volume ``pi a b H (1 + top + top²)/3`` with H
    the frustum's height.
    """
    height = min(a, b) * np.tan(REPOSE) * (1.0 - top)
    inner = np.linspace(0, 1, 41)[1:]
    rho = np.unique(np.concatenate([inner, [top, 1.0] if top > 0 else [1.0]]))
    outer = 1.0 + np.geomspace(0.02, extent / min(a, b) - 1.0, 60)

    def profile(r: F64) -> F64:
        h: F64 = height * np.clip((1.0 - r) / (1.0 - top), 0.0, 1.0)
        return h

    vertices, triangles = polar_mesh(np.concatenate([rho, outer]), a, b, profile, ground)
    volume = np.pi * a * b * height * (1 + top + top * top) / 3.0
    return Scene(name, vertices, triangles, float(volume), _ring_outline(a, b, 1.0), extent)


def box_scene(
    name: str, size: tuple[float, float, float], ground: Ground, extent: float = 20.0
) -> Scene:
    """A box (length, width, height above the mean ground below it)."""
    lx, ly, lz = size
    step = np.arange(-extent, extent + 0.1, 0.2)
    mean = ground.mean_over_box(-lx / 2, lx / 2, -ly / 2, ly / 2)
    body = box_mesh(-lx / 2, lx / 2, -ly / 2, ly / 2, mean - 0.5, mean + lz)
    vertices, triangles = join(grid_mesh(step, step, ground), body)
    outline = np.array([[-lx, -ly], [lx, -ly], [lx, ly], [-lx, ly]]) / 2 * 1.5
    return Scene(
        name,
        vertices,
        triangles,
        lx * ly * lz,
        outline,
        extent,
        platforms=("uav", "rover"),
        flight_m=(6.0, 10.0),
    )


def nist_box() -> Scene:
    """Seed 000 chapter 5: a plywood box in the corner of two perpendicular screens."""
    size = (1.2192, 1.5240, 0.9144)
    floor = box_mesh(0, 9, 0, 9, -0.02, 0.0)
    # not printed: this size fits the printed tables best (docs/study_nist.md)
    screens = [box_mesh(-0.02, 0.0, 0, 2.1, 0, 1.3), box_mesh(0, 2.1, -0.02, 0.0, 0, 1.3)]
    body = box_mesh(0, size[0], 0, size[1], 0, size[2])
    vertices, triangles = join(floor, *screens, body)
    outline = np.array([[0, 0], [2, 0], [2, 2], [0, 2.0]])
    loop = (0.9, 4.8, 4.8, -1.0)  # on the open side of the corner
    return Scene(
        "nist_box",
        vertices,
        triangles,
        float(np.prod(size)),
        outline,
        3.0,
        platforms=("rover",),
        loop_m=loop,
    )


def kern_pit(after: bool) -> Scene:
    """Seed 003: a landfill layer of 2 m and 16 m³, before and after excavation; a frustum with 80
    degree walls.
    """
    depth, inset = 2.0, 2.0 / np.tan(np.radians(80.0))
    # pi depth (R² + R r + r²)/3 = 16 with r = R - inset
    radius = float(np.roots([3.0, -3.0 * inset, inset**2 - 48.0 / (np.pi * depth)]).max())
    top = (radius - inset) / radius
    ground = Ground(rough_m=0.03, length_m=0.8, seed=4)
    rho = np.unique(
        np.concatenate([np.linspace(0, top, 30)[1:], [1.0], 1.0 + np.geomspace(0.02, 6.0, 50)])
    )

    def profile(r: F64) -> F64:
        cut = np.clip((1.0 - r) / (1.0 - top), 0.0, 1.0)
        return -depth * cut if after else np.zeros_like(r)

    vertices, triangles = polar_mesh(rho, radius, radius, profile, ground)
    outline = _ring_outline(radius, radius, 0.5)
    name = "kern_after" if after else "kern_before"
    return Scene(
        name, vertices, triangles, -16.0 if after else 0.0, outline, 10.0, flight_m=(8.0, 15.0)
    )


def sphere() -> Scene:
    """A sphere of 1 m standing on level ground; the mesh is scaled to the exact volume.

    A surface seen from above closes it down to the ground: ``volume_25d_m3`` is the half sphere on
    its cylinder.
    """
    body, triangles = sphere_mesh()
    volume = 4.0 / 3.0 * np.pi
    body = body * (volume / mesh_volume(body, triangles)) ** (1 / 3) + [0, 0, 1.0]
    step = np.linspace(-20, 20, 81)
    vertices, triangles = join(grid_mesh(step, step, Ground()), (body, triangles))
    extra = {"volume_25d_m3": 5.0 / 3.0 * np.pi}
    outline = _ring_outline(1.0, 1.0, 0.5)
    return Scene(
        "sphere", vertices, triangles, volume, outline, 10.0, extra, ("uav",), flight_m=(6.0, 10.0)
    )


def sphere_mesh() -> tuple[F64, I32]:
    """A unit sphere about the origin by one degree: vertices (n, 3), triangles (m, 3), outwards."""
    theta, phi = np.linspace(0, np.pi, 181)[1:-1], 2 * np.pi * np.arange(360) / 360
    body = np.concatenate(
        [
            [[0, 0, 1.0]],
            np.stack(
                [
                    np.outer(np.sin(theta), np.cos(phi)),
                    np.outer(np.sin(theta), np.sin(phi)),
                    np.outer(np.cos(theta), np.ones(360)),
                ],
                -1,
            ).reshape(-1, 3),
            [[0, 0, -1.0]],
        ]
    )
    k, nxt = np.arange(360), (np.arange(360) + 1) % 360
    parts = [np.column_stack([np.zeros(360, int), 1 + k, 1 + nxt])]
    for ring in range(len(theta) - 1):
        lo, hi = 1 + ring * 360, 1 + (ring + 1) * 360
        parts += [
            np.column_stack([lo + k, hi + k, hi + nxt]),
            np.column_stack([lo + k, hi + nxt, lo + nxt]),
        ]
    parts.append(
        np.column_stack(
            [
                1 + (len(theta) - 1) * 360 + k,
                np.full(360, len(body) - 1),
                1 + (len(theta) - 1) * 360 + nxt,
            ]
        )
    )
    return body, np.concatenate(parts).astype(np.int32)


def square() -> Scene:
    """The thesis's square (seed 002 chapter 9): paving with benches, a fountain ring and trees; the
    volume is benches and ring.
    """
    step = np.arange(-14.0, 14.01, 0.0625)
    paving = Ground(rough_m=0.004, length_m=0.5, seed=9)
    parts = [grid_mesh(step, step, paving)]
    volume = 0.0
    for x, y in ((-6.0, 5.0), (0.0, 6.0), (6.0, 5.0)):
        foot = (x - 0.9, x + 0.9, y - 0.25, y + 0.25)
        parts.append(box_mesh(*foot, -0.1, paving.mean_over_box(*foot) + 0.45))
        volume += 1.8 * 0.5 * 0.45
    phi = 2 * np.pi * np.arange(SIDES) / SIDES
    means = [paving.mean_over_disc(0.0, -5.0, r) * r * r for r in (4.0, 3.6)]
    rim = (means[0] - means[1]) / (4.0**2 - 3.6**2) + 0.5
    profile = [(4.0, -0.1), (4.0, rim), (3.6, rim), (3.6, -0.1)]
    ring = np.concatenate(
        [
            np.column_stack([r * np.cos(phi), r * np.sin(phi) - 5.0, np.full(SIDES, z)])
            for r, z in profile
        ]
    )
    k, nxt = np.arange(SIDES), (np.arange(SIDES) + 1) % SIDES
    faces = []
    for a in range(4):
        lo, hi = a * SIDES, ((a + 1) % 4) * SIDES
        faces += [
            np.column_stack([lo + k, lo + nxt, hi + nxt]),
            np.column_stack([lo + k, hi + nxt, hi + k]),
        ]
    parts.append((ring, np.concatenate(faces).astype(np.int32)))
    volume += np.pi * (4.0**2 - 3.6**2) * 0.5
    for x, y in ((-9.0, 9.0), (9.0, 9.0)):
        parts.append(box_mesh(x - 0.15, x + 0.15, y - 0.15, y + 0.15, -0.1, 2.5))
        crown = sphere()
        body = crown.vertices[81 * 81 :] * 1.6 + [x, y, 2.0]
        parts.append((body, crown.triangles[2 * 80 * 80 :] - 81 * 81))
    vertices, triangles = join(*parts)
    outline = np.array([[-8, -10], [8, -10], [8, 7], [-8, 7.0]])  # without the trees
    return Scene("square", vertices, triangles, float(volume), outline, 14.0, flight_m=(12.0, 15.0))


def mesh_volume(vertices: F64, triangles: I32) -> float:
    """Signed volume of a closed mesh, about its centroid."""
    p = (vertices - vertices.mean(axis=0))[triangles]
    return float(np.sum(np.cross(p[:, 0], p[:, 1]) * p[:, 2]) / 6.0)


def make_scene(name: str, seed: int = 0) -> Scene:
    """A scene by name; the seed chooses the ground's roughness. Raises SimulationError for an
    unknown name.
    """
    rough = Ground(slope=(0.012, -0.008), rough_m=0.010, length_m=1.0, seed=seed)
    makers: dict[str, Callable[[], Scene]] = {
        "stockpile": lambda: pile("stockpile", 11.0, 9.0, 0.25, rough),
        "cone": lambda: pile("cone", 10.0, 10.0, 0.0, Ground()),
        "cone_100": lambda: pile("cone_100", 5.14, 5.14, 0.0, rough),
        "frustum": lambda: pile("frustum", 10.0, 10.0, 0.5, Ground(slope=(0.03, 0.0))),
        "stockpile_5000": lambda: pile("stockpile_5000", 22.0, 18.0, 0.2, rough, 60.0),
        "box": lambda: box_scene(
            "box",
            (3.0, 2.0, 1.0),
            Ground(slope=(0.01, 0.005), rough_m=0.003, length_m=0.7, seed=seed),
        ),
        "nist_box": nist_box,
        "kern_before": lambda: kern_pit(False),
        "kern_after": lambda: kern_pit(True),
        "sphere": sphere,
        "square": square,
    }
    if name not in makers:
        raise SimulationError(f"no scene {name!r}; there are {', '.join(makers)}", value=name)
    return makers[name]()
