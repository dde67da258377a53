"""The closed course that the ground robot follows, and the guide posts beside it."""

from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from trustlab.models.checks import finite_array, finite_number, positive, rounded_up, set_checked
from trustlab.models.compiled import njit
from trustlab.teleoperation.records import signal

CORNERS = (
    (0.0, 0.0),
    (13.0, 0.0),
    (13.0, 8.5),
    (8.75, 8.5),
    (8.75, 4.75),
    (4.25, 4.75),
    (4.25, 8.5),
    (0.0, 8.5),
)


# How far from the origin a corner may lie [m].
FARTHEST = 1e5


class CourseNumbers(NamedTuple):
    """
    A `Course` for compiled loops, with tables that spare them most of the search.

    Cell (i, j) of a grid over the course, i · shape_y + j, lists the pieces of the path that may be
    nearest to a point in it: pieces[first[cell] : first[cell + 1]], in order. begins[m] is a piece
    at or before arc length m times `stretch`.
    """

    path: np.ndarray
    posts: np.ndarray
    low_x: float
    low_y: float
    cell: float
    shape_x: int
    shape_y: int
    first: np.ndarray
    pieces: np.ndarray
    begins: np.ndarray
    stretch: float


@njit(_nrt=False)
def piece_distance(x, y, path, i):
    """
    Return the squared distance of a point from a piece of a polyline, the point nearest to it, and
    its arc length.
    """
    ax = path[i, 0]
    ay = path[i, 1]
    s = path[i, 2]
    ux = path[i + 1, 0] - ax
    uy = path[i + 1, 1] - ay
    length = path[i + 1, 2] - s
    along, whole = (x - ax) * ux + (y - ay) * uy, length * length
    share = 0.0 if along <= 0.0 else 1.0
    if 0.0 < along < whole:  # a division takes longer than all the rest, and few pieces need it
        share = min(along / whole, 1.0)
    px, py = ax + share * ux, ay + share * uy
    return (x - px) ** 2 + (y - py) ** 2, px, py, s + share * length


@njit(_nrt=False)
def nearest_point(x, y, path):
    """
    Return the nearest point of a closed polyline, its arc length and its distance: x, y, s, e.
    """
    best = np.inf
    best_x = 0.0
    best_y = 0.0
    best_s = 0.0
    for i in range(path.shape[0] - 1):
        square, px, py, s = piece_distance(x, y, path, i)
        if square < best:
            best = square
            best_x = px
            best_y = py
            best_s = s
    return best_x, best_y, best_s, np.sqrt(best)


@njit(_nrt=False)
def nearest_of(x, y, course):
    """Return the same as `nearest_point`, from the pieces listed for the point's cell alone."""
    i, j = (
        int(np.floor((x - course.low_x) / course.cell)),
        int(np.floor((y - course.low_y) / course.cell)),
    )
    if not (0 <= i < course.shape_x and 0 <= j < course.shape_y):
        return nearest_point(x, y, course.path)
    here = i * course.shape_y + j
    best = np.inf
    best_x = 0.0
    best_y = 0.0
    best_s = 0.0
    for place in range(course.first[here], course.first[here + 1]):
        square, px, py, s = piece_distance(x, y, course.path, course.pieces[place])
        if square < best:
            best = square
            best_x = px
            best_y = py
            best_s = s
    return best_x, best_y, best_s, np.sqrt(best)


@njit(_nrt=False)
def mark_near_pieces(path, low_x, low_y, cell, shape_y, away, near):
    """
    Mark in each row of `near`, one per cell, the pieces no farther from its middle than the
    nearest, and its diagonal.
    """
    for here in range(near.shape[0]):
        x, y = low_x + (here // shape_y + 0.5) * cell, low_y + (here % shape_y + 0.5) * cell
        least = np.inf
        for i in range(away.size):
            away[i] = np.sqrt(piece_distance(x, y, path, i)[0])
            least = min(least, away[i])
        for i in range(away.size):  # a distance changes by at most half a diagonal within the cell
            near[here, i] = away[i] <= least + 1.4143 * cell


@njit(_nrt=False)
def point_at(s, i, path):
    """
    Return the point at arc length `s` on piece i of a polyline, and the unit tangent there: x, y,
    tx, ty.
    """
    step = path[i + 1, 2] - path[i, 2]
    tx, ty = (path[i + 1, 0] - path[i, 0]) / step, (path[i + 1, 1] - path[i, 1]) / step
    return path[i, 0] + (s - path[i, 2]) * tx, path[i, 1] + (s - path[i, 2]) * ty, tx, ty


@njit(_nrt=False)
def path_point(s, path):
    """
    Return the point of a closed polyline at arc length `s` and the unit tangent there: x, y, tx,
    ty.
    """
    last = path.shape[0] - 1
    length = path[last, 2]
    s = s - np.floor(s / length) * length
    i = 0
    while i < last - 1 and path[i + 1, 2] <= s:
        i += 1
    return point_at(s, i, path)


@njit(_nrt=False)
def point_ahead(s, course):
    """
    Return the same as `path_point`, searching from the piece listed for the stretch of the path.
    """
    path = course.path
    last = path.shape[0] - 1
    length = path[last, 2]
    s = s - np.floor(s / length) * length
    i = course.begins[min(int(s / course.stretch), course.begins.size - 1)]
    while i < last - 1 and path[i + 1, 2] <= s:
        i += 1
    return point_at(s, i, path)


# Cells of a course's grid, cells times pieces of the path, and how far beyond the path the grid
# reaches [m].
MOST_CELLS = 20_000
MOST_TRIED = 10_000_000
MARGIN = 2.0


@dataclass(frozen=True)
class Course:
    """
    A closed course of straights and bends: a polygon with rounded corners, between two rows of
    guide posts.

    A lap of the default course takes about as long as the window of (2.4), so that straights and
    bends weigh alike in every window. Posts guide and do not block: a robot that strays passes
    between or through them.

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
        If a corner is not two finite numbers, a length is not positive, or a side is too short for
        its bends.
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
            raise ValueError(
                f"corners must lie within {FARTHEST:g} m of the origin, got "
                f"{np.abs(corners).max():g}"
            )
        set_checked(self, positive, "radius", "post_spacing", "half_width", "resolution")
        around = float(np.hypot(*(np.roll(corners, -1, axis=0) - corners).T).sum())
        for name, most in (("resolution", 100_000), ("post_spacing", 10_000)):
            if around / getattr(self, name) > most:
                raise ValueError(
                    f"{name} = {getattr(self, name):g} m is too fine for a course of about "
                    f"{around:.4g} m; it must be at least {rounded_up(around / most):g} m"
                )
        object.__setattr__(self, "corners", tuple(map(tuple, corners.tolist())))
        object.__setattr__(self, "_path", self._rounded(corners))
        object.__setattr__(self, "_posts", self._post_rows())

    def _rounded(self, corners: np.ndarray) -> np.ndarray:
        ahead = np.roll(corners, -1, axis=0) - corners
        side = np.hypot(*ahead.T)
        if (side == 0.0).any():
            raise ValueError(
                f"corner {int(np.argmax(side == 0.0))} of the course is there twice in a row"
            )
        into = np.roll(ahead / side[:, None], 1, axis=0)
        out = ahead / side[:, None]
        turn = np.arctan2(into[:, 0] * out[:, 1] - into[:, 1] * out[:, 0], (into * out).sum(axis=1))
        cut = self.radius * np.abs(np.tan(turn / 2.0))
        needed = cut + np.roll(cut, -1)
        if (needed > side).any():
            i = int(np.argmax(needed > side))
            raise ValueError(
                f"the side from corner {i} is {side[i]:.3g} m long, but its bends of radius "
                f"{self.radius:g} m take {needed[i]:.3g} m; use a smaller radius or corners "
                "farther apart"
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
            rows += [
                (x - side * self.half_width * ty, y + side * self.half_width * tx)
                for side in (1.0, -1.0)
            ]
        return np.array(rows)

    @cached_property
    def numbers(self) -> CourseNumbers:
        """The course as plain numbers and tables."""
        path = self._path
        low, high = path[:, :2].min(axis=0) - MARGIN, path[:, :2].max(axis=0) + MARGIN
        count = max(1, min(MOST_CELLS, MOST_TRIED // len(path)))
        cell = float(max(np.sqrt(np.prod(high - low) / count), (high - low).max() / count))
        shape_x, shape_y = (max(1, int(size)) for size in np.floor((high - low) / cell))
        near = np.empty((shape_x * shape_y, len(path) - 1), bool)
        mark_near_pieces(path, *low, cell, shape_y, np.empty(len(path) - 1), near)
        first, pieces = np.append(0, np.cumsum(near.sum(axis=1))), np.nonzero(near)[1]
        stretch = self.length / (2 * len(path))
        begins = (
            np.searchsorted(
                path[:, 2], stretch * np.arange(2 * len(path)) * (1.0 - 1e-12), side="right"
            )
            - 1
        )
        low_x, low_y = map(float, low)
        tables = first, pieces, np.maximum(begins, 0), stretch
        return CourseNumbers(path, self._posts, low_x, low_y, cell, shape_x, shape_y, *tables)

    @property
    def path(self) -> np.ndarray:
        """
        The path as a closed polyline, shape (N, 3): x, y and arc length s [m]; the last row is the
        first point.
        """
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
        one, other = (
            [finite_number(n, v)] if np.isscalar(v) else v for n, v in (("x", x), ("y", y))
        )
        one = finite_array("x", one)
        points = np.column_stack([one, finite_array("y", other, length=one.size)])
        return np.array([nearest_point(px, py, self._path)[3] for px, py in points])


@cache
def default_course() -> Course:
    """Return the default course, whose tables are made once per process."""
    return Course()
