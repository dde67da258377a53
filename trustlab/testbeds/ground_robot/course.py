"""The closed course that the ground robot follows, and the guide posts beside it."""

from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple

import numpy as np

from trustlab.models.checks import Checked, NotNegative, finite_numbers, shown
from trustlab.models.compiled import inner, njit

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


# How far from the origin a corner may lie, and how long a lap may be [m].
FARTHEST, LONGEST = 1e5, 1e4

# About how far apart the posts of a row stand, how far from the path the two rows, and the length
# of the straight pieces that bends are made of [m].
POST_SPACING, HALF_WIDTH, RESOLUTION = 2.5, 1.25, 0.1

# The nearest point of the path is looked for so far before and behind that of the last sample [m].
SEARCH = 2.0


class CourseNumbers(NamedTuple):
    """
    A `Course` for compiled loops: the path, shape (N, 3), with arc length in its last column, and
    the posts.
    """

    path: np.ndarray
    posts: np.ndarray


@inner(_nrt=False)
def piece_at(s, path):
    """Return the piece of a polyline that arc length `s` lies on."""
    low, high = 0, path.shape[0] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if path[middle, 2] <= s:
            low = middle
        else:
            high = middle
    return low


@njit(_nrt=False)
def nearest_point(x, y, near, path):
    """
    Return the point of a closed polyline nearest to (x, y), its arc length and distance: x, y, s,
    e.

    Pieces are tried that begin or end within SEARCH of arc length `near`.
    """
    last = path.shape[0] - 1
    length = path[last, 2]
    reach = min(SEARCH, 0.5 * length)
    start = near - reach - np.floor((near - reach) / length) * length
    i = piece_at(start, path)
    ahead = 2.0 * reach + start
    best = np.inf
    best_x, best_y = 0.0, 0.0
    best_s = 0.0
    while path[i, 2] <= ahead:
        ax, ay = path[i, 0], path[i, 1]
        ux, uy = path[i + 1, 0] - ax, path[i + 1, 1] - ay
        length_i = path[i + 1, 2] - path[i, 2]
        along, whole = (x - ax) * ux + (y - ay) * uy, length_i * length_i
        share = 0.0 if along <= 0.0 else 1.0
        if 0.0 < along < whole:  # few pieces need the division
            share = along / whole
        px, py = ax + share * ux, ay + share * uy
        square = (x - px) ** 2 + (y - py) ** 2
        if square < best:
            best = square
            best_x, best_y = px, py
            best_s = path[i, 2] + share * length_i
        i += 1
        if i == last:
            i = 0
            ahead -= length
    return best_x, best_y, best_s, np.sqrt(best)


@njit(_nrt=False)
def path_point(s, path):
    """
    Return the point of a closed polyline at arc length `s` and the unit tangent there: x, y, tx,
    ty.
    """
    length = path[path.shape[0] - 1, 2]
    s = s - np.floor(s / length) * length
    i = piece_at(s, path)
    step = path[i + 1, 2] - path[i, 2]
    tx, ty = (path[i + 1, 0] - path[i, 0]) / step, (path[i + 1, 1] - path[i, 1]) / step
    return path[i, 0] + (s - path[i, 2]) * tx, path[i, 1] + (s - path[i, 2]) * ty, tx, ty


@dataclass(frozen=True)
class Course(Checked):
    """
    A closed course: a polygon with rounded corners, between two rows of guide posts.

    A lap of the default course takes about as long as the window of (2.4), so that straights and
    bends weigh alike in every window. Posts guide and do not block: a robot that strays passes
    between or through them. The nearest point of the path is looked for within 2 m, along the
    path, of where it was a tenth of a second before.

    Parameters
    ----------
    corners : sequence of (float, float)
        The polygon's corners in driving order [m]; at least three.
    radius : float
        Radius of every bend [m]; 0 leaves the polygon as it is, a closed polyline of any shape.

    Raises
    ------
    ValueError
        If a corner is not two finite numbers, the radius is negative, a side is too short for its
        bends, or a lap is longer than 10 km.

    Examples
    --------
    >>> import trustlab as tl
    >>> triangle = tl.testbeds.Course(((0, 0), (9, 0), (9, 12)), radius=0)
    >>> triangle.length
    36.0
    """

    corners: tuple[tuple[float, float], ...] = CORNERS
    radius: NotNegative = 1.75
    _path: np.ndarray = field(init=False, repr=False, compare=False)
    _posts: np.ndarray = field(init=False, repr=False, compare=False)

    def __post_init__(self):
        corners = finite_numbers("corners", self.corners)
        if corners.shape[1:] != (2,) or len(corners) < 3 or np.abs(corners).max() > FARTHEST:
            raise ValueError(
                f"corners must be three pairs (x, y) or more, within {FARTHEST:g} m of the origin, "
                f"got {shown(self.corners)}"
            )
        super().__post_init__()
        around = float(np.hypot(*(np.roll(corners, -1, axis=0) - corners).T).sum())
        if around > LONGEST:
            raise ValueError(f"a lap may be {LONGEST:g} m long, got corners {around:.4g} m around")
        self.__dict__["corners"] = tuple(map(tuple, corners.tolist()))
        self.__dict__["_path"] = self._rounded(corners)
        self.__dict__["_posts"] = self._post_rows()

    def _rounded(self, corners: np.ndarray) -> np.ndarray:
        """Return the path with its arc length, closed; points of the plane are complex numbers."""
        places = corners @ (1.0, 1j)
        ahead = np.roll(places, -1) - places
        side = np.abs(ahead)
        if (side == 0.0).any():
            raise ValueError(
                f"corner {int(np.argmax(side == 0.0))} of the course is there twice in a row"
            )
        out = ahead / side
        into = np.roll(out, 1)
        turn = np.angle(out * into.conj())
        cut = self.radius * np.abs(np.tan(turn / 2.0))
        needed = cut + np.roll(cut, -1)
        if (needed > side).any():
            i = int(np.argmax(needed > side))
            raise ValueError(
                f"the side from corner {i} is {side[i]:.3g} m long, but its bends of radius "
                f"{self.radius:g} m take {needed[i]:.3g} m; use a smaller radius or corners "
                "farther apart"
            )
        bends = []
        for begins, u, angle in zip(places - cut * into, into, turn, strict=True):
            count = max(2, int(np.ceil(self.radius * abs(angle) / RESOLUTION)) + 1)
            spoke = -self.radius * np.sign(angle) * 1j * u
            bends.append(begins - spoke + spoke * np.exp(1j * np.linspace(0.0, angle, count)))
        path = np.concatenate([*bends, bends[0][:1]])
        path = path[np.r_[True, np.abs(np.diff(path)) > 1e-9]]
        path[-1] = path[0]
        s = np.r_[0.0, np.cumsum(np.abs(np.diff(path)))]
        return np.column_stack([path.real, path.imag, s])

    def _post_rows(self) -> np.ndarray:
        count = max(2, round(self.length / POST_SPACING))
        rows = []
        for i in range(count):
            x, y, tx, ty = path_point((i + 0.5) * self.length / count, self._path)
            rows += [(x - side * ty, y + side * tx) for side in (HALF_WIDTH, -HALF_WIDTH)]
        return np.array(rows)

    @property
    def numbers(self) -> CourseNumbers:
        """The course for compiled loops."""
        return CourseNumbers(self._path, self._posts)

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


@cache
def default_course() -> Course:
    """Return the default course, made once per process."""
    return Course()
