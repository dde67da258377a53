"""The UAV as transfer functions from command to velocity, (A.1)."""

from dataclasses import dataclass

import numpy as np
import scipy

from trustlab.models.checks import finite_array, finite_number, positive, set_checked


@dataclass(frozen=True)
class TransferFunction:
    """
    A transfer function without zeros, gain/(s + d_0) or gain/(s² + d_1 s + d_0).

    Parameters
    ----------
    gain : float
        The numerator; not zero.
    denominator : tuple of float
        (d_0,) or (d_1, d_0), as printed: without the leading 1.

    Raises
    ------
    ValueError
        If a number is not finite, the gain is zero, or there are not one or two coefficients.

    Examples
    --------
    >>> import trustlab as tl
    >>> tl.TransferFunction(0.985, (0.4952,)).poles().round(4)
    array([-0.4952+0.j])
    """

    gain: float
    denominator: tuple[float, ...]

    def __post_init__(self):
        set_checked(self, finite_number, "gain")
        if self.gain == 0.0:
            raise ValueError("gain must not be zero: the command would have no effect")
        numbers = tuple(finite_array("denominator", self.denominator).tolist())
        if len(numbers) > 2:
            raise ValueError(
                "denominator must have one or two coefficients, highest power first, got "
                f"{len(numbers)}"
            )
        object.__setattr__(self, "denominator", numbers)

    @property
    def order(self) -> int:
        """1 or 2."""
        return len(self.denominator)

    def poles(self) -> np.ndarray:
        """Return the poles [1/s], complex, shape (order,)."""
        return np.roots((1.0, *self.denominator)).astype(complex)

    def matrices(self) -> tuple[np.ndarray, np.ndarray]:
        """Return A, shape (n, n), and B, shape (n,), of the state (v) or (v, dv/dt)."""
        transition = np.eye(self.order, k=1)
        transition[-1] = np.negative(self.denominator[::-1])
        return transition, self.gain * np.eye(self.order)[-1]

    def discrete(self, sample_time: float) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the exact one-sample matrices for a command that is held over the sample.

        Parameters
        ----------
        sample_time : float
            T [s], positive.

        Returns
        -------
        Phi : numpy.ndarray, shape (n, n)
            State transition.
        Gamma : numpy.ndarray, shape (n,)
            Effect of the command.

        Raises
        ------
        ValueError
            If `sample_time` is not positive, or so long that the matrices are infinite.
        """
        sample_time = positive("sample_time", sample_time)
        phi, gamma = held_over(sample_time, *self.matrices())
        if not (np.isfinite(phi).all() and np.isfinite(gamma).all()):
            raise ValueError(f"sample_time = {sample_time:g} s is too long for the poles of {self}")
        return phi, gamma


def held_over(sample_time: float, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return Φ and Γ of dx/dt = A x + B u over a sample in which u is held."""
    # exp of [[A, B], [0, 0]] holds both the transition and the integral of the command
    block = np.pad(np.column_stack([a, b]), ((0, 1), (0, 0)))
    with np.errstate(all="ignore"):
        exponential = scipy.linalg.expm(block * sample_time)
    return exponential[:-1, :-1], exponential[:-1, -1]


def three_axes(vehicle) -> tuple[TransferFunction, ...]:
    """
    Return a vehicle's transfer functions on x, y and z as a tuple.

    Parameters
    ----------
    vehicle : sequence of three TransferFunction
        Command to velocity per axis.

    Raises
    ------
    ValueError
        If it is anything else.
    """
    three = isinstance(vehicle, (tuple, list)) and len(vehicle) == 3
    if three and all(isinstance(axis, TransferFunction) for axis in vehicle):
        return tuple(vehicle)
    raise ValueError(
        f"a vehicle needs three transfer functions, for x, y and z, got {type(vehicle).__name__} "
        f"{vehicle!r:.60}"
    )


# (A.1): identified from flights of a Parrot AR.Drone 2.0, command to velocity [m/s].
PRINTED_UAV = {
    "x": TransferFunction(9.22, (1.475, 0.2214)),
    "y": TransferFunction(3.806, (0.4706, 2.457)),
    "z": TransferFunction(0.985, (0.4952,)),
}
