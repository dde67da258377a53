"""The closed course that the ground robot follows, and the guide posts beside it."""

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, NamedTuple

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


# How long a lap may be [m].
LONGEST = 1e4

# About how far apart the posts of a row stand, how far from the path the two rows, and the length
# of the straight pieces that bends are made of [m].
POST_SPACING, HALF_WIDTH, RESOLUTION = 2.5, 1.25, 0.1

# The nearest point of the path is looked for so far before and behind that of the last sample [m].
SEARCH = 2.0


class CourseNumbers(NamedTuple):
    """
    A `Course` for compiled loops: points of the path, shape (N,), the last the first again, with
    their arc lengths, the unit tangents from each to the next, and the posts. Points of the plane
    are complex numbers.
    """

    points: np.ndarray
    tangents: np.ndarray
    arcs: np.ndarray
    posts: np.ndarray


@inner
def size(vector):
    """Return the length of a vector of the plane."""
    return np.sqrt(vector.real**2 + vector.imag**2)


@inner
def direction(angle):
    """Return the unit vector at an angle."""
    return complex(np.cos(angle), np.sin(angle))


@inner
def angle_of(vector):
    """Return the angle of a vector of the plane."""
    return np.arctan2(vector.imag, vector.real)


@inner(_nrt=False)
def piece_at(s, arcs):
    """Return the piece of a polyline that arc length `s` lies on."""
    return min(np.searchsorted(arcs, s, side="right"), arcs.size - 1) - 1


@njit(_nrt=False)
def nearest_point(place, near, course):
    """
    Return the point of the path nearest to a place, its arc length and its distance.

    Pieces are tried that begin or end within SEARCH of arc length `near`.
    """
    points, tangents, arcs = course.points, course.tangents, course.arcs
    last = arcs.size - 1
    length = arcs[last]
    reach = min(SEARCH, 0.5 * length)
    start = near - reach - np.floor((near - reach) / length) * length
    i = piece_at(start, arcs)
    ahead = 2.0 * reach + start
    best, nearest, past = np.inf, i, 0.0
    while arcs[i] <= ahead:
        way, off = tangents[i], place - points[i]
        along = min(max(off.real * way.real + off.imag * way.imag, 0.0), arcs[i + 1] - arcs[i])
        square = (off.real - along * way.real) ** 2 + (off.imag - along * way.imag) ** 2
        if square < best:
            best, nearest, past = square, i, along
        i += 1
        if i == last:
            i = 0
            ahead -= length
    return points[nearest] + past * tangents[nearest], arcs[nearest] + past, np.sqrt(best)


@njit(_nrt=False)
def path_point(s, course):
    """Return the point of the path at arc length `s` and the unit tangent there."""
    arcs = course.arcs
    length = arcs[arcs.size - 1]
    s = s - np.floor(s / length) * length
    i = piece_at(s, arcs)
    return course.points[i] + (s - arcs[i]) * course.tangents[i], course.tangents[i]


def course_numbers(path: Any, posts: Any) -> CourseNumbers:
    """Return a course for compiled loops from its `path` and `posts`."""
    x, y, arcs = np.array(path, float).T.copy()
    points = x + 1j * y
    pieces = np.diff(points)
    return CourseNumbers(points, pieces / np.abs(pieces), arcs, np.asarray(posts) @ (1.0, 1j))


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

    def __post_init__(self):
        corners = finite_numbers("corners", self.corners)
        if corners.shape[1:] != (2,) or len(corners) < 3:
            raise ValueError(
                f"corners must be three pairs (x, y) or more, got {shown(self.corners)}"
            )
        super().__post_init__()
        self.__dict__["corners"] = tuple(map(tuple, corners.tolist()))
        if self.length > LONGEST:
            raise ValueError(f"a lap may be {LONGEST:g} m long, got corners of {self.length:.4g} m")

    @cached_property
    def path(self) -> np.ndarray:
        """
        The path as a closed polyline, shape (N, 3): x, y and arc length s [m]; the last row is the
        first point.
        """
        places = np.array(self.corners) @ (1.0, 1j)
        ahead = np.roll(places, -1) - places
        side = np.abs(ahead)
        out = ahead / np.maximum(side, 1e-300)
        into = np.roll(out, 1)
        turn = np.angle(out * into.conj())
        cut = self.radius * np.abs(np.tan(turn / 2.0))
        needed = cut + np.roll(cut, -1)
        short = (needed > side) | (side == 0.0)
        if short.any():
            i = int(short.argmax())
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
        arcs = np.cumsum(np.abs(np.diff(path, prepend=path[0])))
        rows = np.column_stack([path.real, path.imag, arcs])
        rows.flags.writeable = False
        return rows

    @property
    def length(self) -> float:
        """Length of a lap [m]."""
        return float(self.path[-1, 2])

    @property
    def posts(self) -> np.ndarray:
        """Positions of the guide posts [m], shape (posts, 2), left and right in turn."""
        path = course_numbers(self.path, np.empty((0, 2)))
        count = max(2, round(self.length / POST_SPACING))
        rows = []
        for i in range(count):
            point, tangent = path_point((i + 0.5) * self.length / count, path)
            rows += [point + side * tangent for side in (1j * HALF_WIDTH, -1j * HALF_WIDTH)]
        return np.array(rows).view(float).reshape(-1, 2)

    @cached_property
    def numbers(self) -> CourseNumbers:
        """The course for compiled loops."""
        return course_numbers(self.path, self.posts)


@cache
def default_course() -> Course:
    """Return the default course, made once per process."""
    return Course()
