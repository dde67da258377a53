"""The closed course that the ground robot follows, and the guide posts beside it."""

from dataclasses import dataclass, field

import numpy as np

from trustlab.models.checks import finite_array, finite_number, positive
from trustlab.models.compiled import njit
from trustlab.teleoperation.records import signal

CORNERS = ((0.0, 0.0), (13.0, 0.0), (13.0, 8.5), (8.75, 8.5), (8.75, 4.75), (4.25, 4.75), (4.25, 8.5), (0.0, 8.5))


FARTHEST = 1e5
"""How far from the origin a corner may lie [m]."""


@njit
def nearest_point(x, y, path):
    """Return the nearest point of a closed polyline, its arc length and its distance: x, y, s, e."""
    best, best_x, best_y, best_s = np.inf, 0.0, 0.0, 0.0
    for i in range(path.shape[0] - 1):
        ax, ay, s = path[i, 0], path[i, 1], path[i, 2]
        ux, uy, length = path[i + 1, 0] - ax, path[i + 1, 1] - ay, path[i + 1, 2] - s
        share = ((x - ax) * ux + (y - ay) * uy) / (length * length)
        share = min(max(share, 0.0), 1.0)
        px, py = ax + share * ux, ay + share * uy
        square = (x - px) ** 2 + (y - py) ** 2
        if square < best:
            best, best_x, best_y, best_s = square, px, py, s + share * length
    return best_x, best_y, best_s, np.sqrt(best)


@njit
def path_point(s, path):
    """Return the point of a closed polyline at arc length `s` and the unit tangent there: x, y, tx, ty."""
    last = path.shape[0] - 1
    length = path[last, 2]
    s = s - np.floor(s / length) * length
    i = min(np.searchsorted(path[:, 2], s, side="right") - 1, last - 1)
    step = path[i + 1, 2] - path[i, 2]
    tx, ty = (path[i + 1, 0] - path[i, 0]) / step, (path[i + 1, 1] - path[i, 1]) / step
    return path[i, 0] + (s - path[i, 2]) * tx, path[i, 1] + (s - path[i, 2]) * ty, tx, ty


@dataclass(frozen=True)
class Course:
    """
    A closed course of straights and bends: a polygon with rounded corners, between two rows of guide posts.

    A lap of the default course takes about as long as the window of (2.4), so that straights and bends weigh alike
    in every window. Posts guide and do not block: a robot that strays passes between or through them.

    Parameters
    ----------
    corners : sequence of (float, float)
        The polygon's corners in driving order [m]; at least three.
    radius : float
        Radius of every bend [m].
    post_spacing : float
        About how far apart the posts of a row stand [m]; made to fit a whole number in.
    half_width : float
        How far from the path the two rows stand [m].
    resolution : float
        Length of the straight pieces that the path is made of [m].

    Raises
    ------
    ValueError
        If a corner is not two finite numbers, a length is not positive, or a side is too short for its bends.
    """

    corners: tuple[tuple[float, float], ...] = CORNERS
    radius: float = 1.75
    post_spacing: float = 2.5
    half_width: float = 1.25
    resolution: float = 0.1
    _path: np.ndarray = field(init=False, repr=False, compare=False)
    _posts: np.ndarray = field(init=False, repr=False, compare=False)

    def __post_init__(self):
        corners = signal("corners", self.corners, columns=2, least=3)
        if np.abs(corners).max() > FARTHEST:
            raise ValueError(f"corners must lie within {FARTHEST:g} m of the origin, got {np.abs(corners).max():g}")
        for name in ("radius", "post_spacing", "half_width", "resolution"):
            object.__setattr__(self, name, positive(name, getattr(self, name)))
        around = float(np.hypot(*(np.roll(corners, -1, axis=0) - corners).T).sum())
        for name, most in (("resolution", 100_000), ("post_spacing", 10_000)):
            if around / getattr(self, name) > most:
                raise ValueError(
                    f"{name} = {getattr(self, name):g} m is too fine for a course of about {around:.4g} m; it must be at "
                    f"least {around / most:.3g} m"
                )
        object.__setattr__(self, "corners", tuple(map(tuple, corners.tolist())))
        object.__setattr__(self, "_path", self._rounded(corners))
        object.__setattr__(self, "_posts", self._post_rows())

    def _rounded(self, corners: np.ndarray) -> np.ndarray:
        ahead = np.roll(corners, -1, axis=0) - corners
        side = np.hypot(*ahead.T)
        if (side == 0.0).any():
            raise ValueError(f"corner {int(np.argmax(side == 0.0))} of the course is there twice in a row")
        into = np.roll(ahead / side[:, None], 1, axis=0)
        out = ahead / side[:, None]
        turn = np.arctan2(into[:, 0] * out[:, 1] - into[:, 1] * out[:, 0], (into * out).sum(axis=1))
        cut = self.radius * np.abs(np.tan(turn / 2.0))
        needed = cut + np.roll(cut, -1)
        if (needed > side).any():
            i = int(np.argmax(needed > side))
            raise ValueError(
                f"the side from corner {i} is {side[i]:.3g} m long, but its bends of radius {self.radius:g} m take "
                f"{needed[i]:.3g} m; use a smaller radius or corners farther apart"
            )
        pieces = []
        for corner, u, angle, back in zip(corners, into, turn, cut, strict=True):
            count = max(2, int(np.ceil(self.radius * abs(angle) / self.resolution)) + 1)
            along = np.linspace(0.0, angle, count)
            normal = np.sign(angle) * np.array([-u[1], u[0]])
            centre = corner - back * u + self.radius * normal
            cos, sin = np.cos(along)[:, None], np.sin(along)[:, None]
            spoke = -self.radius * normal
            pieces.append(centre + cos * spoke + sin * np.array([-spoke[1], spoke[0]]))
        points = np.concatenate(pieces)
        points = np.concatenate([points, points[:1]])
        apart = np.hypot(*np.diff(points, axis=0).T)
        points = points[np.r_[True, apart > 1e-9]]
        points[-1] = points[0]
        apart = np.hypot(*np.diff(points, axis=0).T)
        return np.column_stack([points, np.r_[0.0, np.cumsum(apart)]])

    def _post_rows(self) -> np.ndarray:
        count = max(2, round(self.length / self.post_spacing))
        rows = []
        for i in range(count):
            x, y, tx, ty = path_point((i + 0.5) * self.length / count, self._path)
            rows += [(x - side * self.half_width * ty, y + side * self.half_width * tx) for side in (1.0, -1.0)]
        return np.array(rows)

    @property
    def path(self) -> np.ndarray:
        """The path as a closed polyline, shape (N, 3): x, y and arc length s [m]; the last row is the first point."""
        return self._path.copy()

    @property
    def posts(self) -> np.ndarray:
        """Positions of the guide posts [m], shape (posts, 2), left and right in turn."""
        return self._posts.copy()

    @property
    def length(self) -> float:
        """Length of a lap [m]."""
        return float(self._path[-1, 2])

    def distance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """
        Return the distance of points from the path.

        Parameters
        ----------
        x, y : array_like, shape (N,)
            Positions [m].

        Returns
        -------
        numpy.ndarray, shape (N,)
            Distance to the nearest point of the path [m].

        Raises
        ------
        ValueError
            If a position is not finite, or x and y differ in length.
        """
        one, other = ([finite_number(n, v)] if np.isscalar(v) else v for n, v in (("x", x), ("y", y)))
        one = finite_array("x", one)
        points = np.column_stack([one, finite_array("y", other, length=one.size)])
        return np.array([nearest_point(px, py, self._path)[3] for px, py in points])
