"""Photographs from the hand brought into one place: translation and rotation, to a fraction of a pixel.

Neighbours of a bracket show the same scene at two exposures. Their cumulative histograms show which value of one
corresponds to which of the other, for any response and almost any movement. With them the brighter one is brought to
the values of the darker one. Both are cut off where the brighter one clips. The movement between the two is then the
one of highest correlation, sought from coarse to fine.

The method is that of OpenCV's findTransformECC for a shift and a turn, whose every call blurs and derives anew and asks
for a dozen arrays as large as the picture. Here all climbs of a pair share what is computed from the two pictures.
The sums of a step are made in blocks of rows that stay in a core's caches. This takes less than half of the processor
time.

Every sum is one over the pixels that both pictures show, of what differs from its mean over these: so the coefficient
is defined, and its slopes with it. OpenCV lets the slopes reach beyond them, where the moved picture is not centred:
little contrast on a high pedestal then leads astray by tens of pixels. Where nothing slopes at the rim of what is shown
the steps are the same.

Source: G. D. Evangelidis, E. Z. Psarakis 2008, IEEE Trans. PAMI 30, 1858–1865 (forward additive).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from radiometer.data import Bracket, Frame
from radiometer.errors import MeasurementError
from radiometer.typing import Array, Image

BLUR_PX: Final = 5  # the size of findTransformECC's own filter: noise moves no slope
_LEAST_STEP: Final = 1e-6  # of the correlation
# Of the blur's pixels so many must show something.
_SHOWN_SHARE: Final = 0.95
_BLOCK_PX: Final = 16384
_CENTRAL: Final = np.array([[-0.5, 0.0, 0.5]], np.float32)
# Of a movement: a turn, a shift to the right and one down. A block holds the moved picture's derivatives by these, the
# moved picture and the still one, all of them where both show something, and 1 there.
_PARAMETERS: Final = 3
_OF_MOVING, _OF_STILL, _OF_SHOWN, _ROWS = 3, 4, 5, 6


class Climb:
    """Two pictures of one shape, ready to be compared at any movement."""

    def __init__(self, still: Image, moving: Image, inside: NDArray[np.uint8]) -> None:
        """Blur both pictures and take the slopes of the second.

        Args:
            still: The one picture, shape (height, width).
            moving: The other, in the same grey values.
            inside: 1 where both show something.
        """
        blur = (BLUR_PX, BLUR_PX)
        self.shape = (int(still.shape[0]), int(still.shape[1]))
        # Sums of squares in 32 bits are those of what differs from a mean, or little contrast would drown in them.
        self._still, blurred = (cv2.GaussianBlur(one - np.float32(one.mean()), blur, 0) for one in (still, moving))
        self._shown = (cv2.GaussianBlur(inside.astype(np.float32), blur, 0) > _SHOWN_SHARE).astype(np.uint8)
        slopes = [cv2.filter2D(blurred, -1, kernel) for kernel in (_CENTRAL, _CENTRAL.T)]
        # Four channels are moved at once, faster than three.
        self._moving = cv2.merge([blurred, *slopes, slopes[0]])
        self._rows = max(1, _BLOCK_PX // self.shape[1])
        self._block = np.empty((_ROWS, self._rows, self.shape[1]), np.float32)
        self._moved, self._moved_shown = np.empty_like(self._moving), np.empty_like(self._shown)

    def climbed(self, start: Array, iterations: int) -> tuple[float, Array]:
        """Return the correlation before the last of the steps from a movement, and the movement after it.

        Args:
            start: Matrix, shape (2, 3), that takes a pixel of the first picture to its place in the second.
            iterations: Steps at most; fewer where the correlation no longer changes.

        Raises:
            MeasurementError: If the pictures have no correlation there.
        """
        movement, before, correlation = start, -_LEAST_STEP, -1.0
        for _ in range(iterations):
            if abs(correlation - before) < _LEAST_STEP:
                break
            before = correlation
            correlation, movement = self._step(movement)
        return correlation, movement

    def _step(self, movement: Array) -> tuple[float, Array]:
        """Return the correlation at a movement, and the movement a step further up."""
        products, pixels = self._products(movement)
        # Products of what differs from the means of the pixels shown.
        sums = products[:, _OF_SHOWN]
        centred = products[:, :_OF_SHOWN] - np.outer(sums, sums) / max(pixels, 1)
        slopes = slice(_PARAMETERS)
        square, both, still_square = (
            centred[_OF_MOVING, _OF_MOVING],
            centred[_OF_MOVING, _OF_STILL],
            centred[_OF_STILL, _OF_STILL],
        )
        of_moving, of_still = centred[slopes, _OF_MOVING], centred[slopes, _OF_STILL]
        if not square * still_square > 0.0:
            raise MeasurementError(
                "the pictures have nothing in common by which they could be aligned; take them of one scene"
            )
        try:
            inverse = np.linalg.inv(centred[slopes, slopes])
        except np.linalg.LinAlgError:  # no slope: nowhere to go
            inverse = np.zeros((_PARAMETERS, _PARAMETERS))
        towards = inverse @ of_moving
        brighter, darker = square - of_moving @ towards, both - of_still @ towards
        if not darker > 0.0:
            raise MeasurementError(
                "the pictures are displaced too far, or too different, to be aligned; take them from one place"
            )
        turn, right, down = inverse @ (brighter / darker * of_still - of_moving)
        angle = math.asin(movement[1, 0]) + turn
        turned = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        reached = float(both) / math.sqrt(square * still_square)
        return reached, np.column_stack([turned, movement[:, 2] + (right, down)])

    def _products(self, movement: Array) -> tuple[Array, int]:
        """Return sums of products over pixels, shape (5, 6), as a block's rows have them, and how many they are."""
        (height, width), flags = self.shape, cv2.WARP_INVERSE_MAP
        # Half a pixel beyond its edge a picture still counts as shown.
        moved = cv2.warpAffine(
            self._moving,
            movement,
            (width, height),
            dst=self._moved,
            flags=flags | cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        shown = cv2.warpAffine(
            self._shown, movement, (width, height), dst=self._moved_shown, flags=flags | cv2.INTER_NEAREST
        )
        cos, sin = float(movement[0, 0]), float(movement[1, 0])
        x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
        found = np.zeros((_OF_SHOWN, _ROWS))
        for top in range(0, height, self._rows):
            rows = slice(top, min(top + self._rows, height))
            block, part = self._block[:, : rows.stop - top], moved[rows]
            block[_OF_SHOWN] = shown[rows]
            for k, row in enumerate((_OF_MOVING, 1, 2)):
                np.multiply(part[..., k], block[_OF_SHOWN], out=block[row])
            np.multiply(-sin * x - cos * y[rows], block[1], out=block[0])
            block[0] += (cos * x - sin * y[rows]) * block[2]
            np.multiply(self._still[rows], block[_OF_SHOWN], out=block[_OF_STILL])
            flat = block.reshape(_ROWS, -1)
            found += flat[:_OF_SHOWN] @ flat.T
        return found, cv2.countNonZero(shown)


# Larger pictures are reduced to this for the estimate, which is then good to some hundredths of a reduced pixel.
_ENOUGH_PIXELS: Final = 800_000
# Of so many it is seen first whether a pair moved at all.
_GLANCE_PIXELS: Final = 100_000
_COARSEST_PX: Final = 48
# From afar; where a coarser picture has given the place, a few steps of Gauss and Newton lead to the top or there is
# none.
_ITERATIONS: Final = 60
_ITERATIONS_NEAR: Final = 15
# A step of less in pixels is none.
_ARRIVED_PX: Final = 0.02
# Corners that move less count as still: a resampling would change more than it improves.
LEAST_MOVE_PX: Final = 0.25
# A movement must lessen the mean square difference of neighbours to this share, or it is noise.
_LEAST_GAIN: Final = 0.97
# A movement that is known worse than this, in pixels of the bracket, counts as unknown.
_WORST_U_PX: Final = 0.2
# Grey values are counted in so many steps.
_STEPS: Final = 65536
# So many blurred pixels differ alike.
_ALIKE_PX: Final = 16.0
# The picture is looked at in so many by so many parts.
_PARTS: Final = 6
# Part of the squared differences that count, and their mean over the variance of a normal distribution.
_KEPT: Final = 0.9
_KEPT_VARIANCE: Final = 0.6230
# What differs by more than this has moved.
_MOVED_SIGMA: Final = 6.0
# Of a neighbour's pixels that must be well exposed in both.
_LEAST_SHARE: Final = 0.02
_STILL: Final = np.eye(2, 3)
_NEIGHBOURS: Final = np.ones((3, 3), np.uint8)
# Part of a picture that is looked at as a rim, and of its white that may have moved away in the longest exposure.
_LEAST_RIM: Final = 1e-3
_MOST_MOVED_WHITE: Final = 0.5
# Pictures of fewer pixels across hold nothing to hold a movement by.
_LEAST_SIDE_PX: Final = 8
# Cubic interpolation looks at pixels so far away.
_SUPPORT_PX: Final = 2
# OpenCV reads values at places of 1/32 pixel (INTER_BITS): half of a step is no movement beyond an edge.
_PLACE_STEP_PX: Final = 1.0 / 64.0


@dataclass(frozen=True, slots=True, eq=False)
class Movement:
    """Place of a frame relative to the reference frame."""

    to_frame: Array  # matrix, shape (2, 3), that takes a pixel (x, y, 1) of the reference to its place in the frame
    known: bool = True  # whether the frames had enough in common to determine it

    @property
    def rotation_deg(self) -> float:
        """Return the rotation in degrees."""
        return math.degrees(math.atan2(self.to_frame[1, 0], self.to_frame[0, 0]))

    def largest_px(self, shape: tuple[int, int]) -> float:
        """Return by how many pixels the corner that moves most is displaced.

        Args:
            shape: (height, width) in pixels.
        """
        corners = _corners(shape)
        moved = corners @ self.to_frame[:, :2].T + self.to_frame[:, 2]
        return float(np.linalg.norm(moved - corners, axis=1).max())


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Where the frames of a bracket are relative to each other."""

    movements: tuple[Movement, ...]  # one per frame, in the bracket's order
    reference: int  # index of the frame that stays
    shape: tuple[int, int]  # (height, width) in pixels

    @property
    def largest_px(self) -> float:
        """Return the largest displacement of a corner in pixels."""
        return max(one.largest_px(self.shape) for one in self.movements)

    def trimmed(self, bracket: Bracket) -> Bracket:
        """Return the part of an aligned bracket that all its frames show."""
        height, width = self.shape
        rim = min(math.ceil(self.largest_px) + 1, min(height, width) // 4)
        cut = slice(rim, height - rim), slice(rim, width - rim)
        frames = tuple(replace(one, dn=np.ascontiguousarray(one.dn[cut])) for one in bracket.light)  # type: ignore[arg-type]
        return replace(bracket, light=frames, dark=())

    @property
    def needed(self) -> bool:
        """Return whether any frame moved by more than a resampling would cost."""
        return self.largest_px >= LEAST_MOVE_PX

    def sentence(self, names: Sequence[str], *, moved: bool = False) -> str:
        """Return what was found in a sentence.

        Args:
            moved: Whether the frames are moved even where they hardly need it.
        """
        lost = [name for name, one in zip(names, self.movements, strict=True) if not one.known]
        named = " and ".join(lost if len(lost) < 3 else (f"frame {lost[0]}", f"{len(lost) - 1} others"))
        doubt = f"; unknown for {named}: too little in common" if lost else ""
        if not (self.needed or moved):
            return f"aligned already: no frame fits better moved by {LEAST_MOVE_PX:g} pixels or more{doubt}"
        turned = max(abs(one.rotation_deg) for one in self.movements)
        # A frame of unknown movement moves like its neighbour, whose movement was measured.
        most = max(range(len(names)), key=lambda k: (self.movements[k].largest_px(self.shape), self.movements[k].known))
        return (
            f"aligned to {names[self.reference]}: moved by up to {self.largest_px:.2g} pixels ({names[most]}) and "
            f"{turned:.2f}°{doubt}"
        )


def find_alignment(bracket: Bracket, progress: Callable[[int, int], None] = lambda done, total: None) -> Alignment:
    """Return where the frames of a bracket are relative to each other.

    Args:
        bracket: Frames of one scene from the shortest exposure to the longest; of colour photographs one channel.
        progress: Called after every frame with the number of frames that are placed, and of all.
    """
    reference = _reference(bracket)
    small = [_reduced(frame.dn, _GLANCE_PIXELS) for frame in bracket.light]
    white_rims = _has_white_rims(small, bracket.light[0].full_scale_dn)
    glance = _Pictures(bracket, small.__getitem__, white_rims)
    fine = _Pictures(bracket, lambda k: _reduced(bracket.light[k].dn, _ENOUGH_PIXELS), white_rims)
    found: dict[int, Movement] = {reference: Movement(_STILL)}
    for step in (1, -1):
        for k in range(reference + step, len(bracket.light) if step > 0 else -1, step):
            before = found[k - step]
            own = _STILL if glance.stand_still(k - step, k) else fine.movement(k - step, k)
            found[k] = Movement(_after(_STILL if own is None else own, before.to_frame), own is not None)
            progress(len(found), len(bracket.light))
    return Alignment(tuple(found[k] for k in range(len(bracket.light))), reference, bracket.shape)


class _Pictures:
    """The frames of a bracket as smaller pictures, made of two of them at a time."""

    def __init__(self, bracket: Bracket, reduced: Callable[[int], Image], white_rims: bool) -> None:
        self._bracket, self._reduced, self._white_rims = bracket, reduced, white_rims
        self._made: dict[int, tuple[Image, NDArray[np.uint8]]] = {}

    def movement(self, first: int, second: int) -> Array | None:
        """Return the movement in pixels of the bracket that takes those of one frame to another; None if not known."""
        pair, scale = self._pair(first, second)
        return None if pair is None or pair.u_px * scale > _WORST_U_PX else _full_size(pair.to_frame, scale)

    def stand_still(self, first: int, second: int) -> bool:
        """Return whether two frames are in one place, known as well as any movement must be."""
        pair, scale = self._pair(first, second)
        return pair is not None and not pair.moved and pair.u_px * scale <= _WORST_U_PX

    def _pair(self, first: int, second: int) -> tuple[_PairMovement | None, float]:
        """Return the movement in pixels of the pictures, and how many of the bracket's pixels one of these covers."""
        self._made = {k: self._made.get(k) or self._picture(k) for k in (first, second)}
        (here, shown), (there, also_shown) = (self._made[k] for k in (first, second))
        pair = _pair_movement(here, there, shown & also_shown, self._bracket.light[first].full_scale_dn)
        return pair, self._bracket.shape[1] / here.shape[1]

    def _picture(self, k: int) -> tuple[Image, NDArray[np.uint8]]:
        """Return a frame and 1 where it shows something."""
        picture = self._reduced(k)
        shown = _inside(picture)
        top = self._bracket.light[k].full_scale_dn
        return picture, shown & _inside(picture, top) if self._white_rims else shown


@dataclass(frozen=True, slots=True, eq=False)
class _PairMovement:
    """The movement between two pictures."""

    to_frame: Array  # matrix, shape (2, 3); no movement where it would improve nothing
    u_px: float  # standard uncertainty of a corner's place, in pixels of these pictures
    moved: bool  # whether it improves anything


def aligned(bracket: Bracket, alignment: Alignment) -> tuple[Bracket, list[NDArray[np.bool_]]]:
    """Return the bracket with every frame brought to the reference's place, and where a frame then shows nothing.

    Values between pixels are read off cubic splines through them; where one of these clips and another does not, the
    value is unknown. Beyond a frame's edge stands its last row or column.
    """
    frames, absent = [], []
    for frame, movement in zip(bracket.light, alignment.movements, strict=True):
        if np.array_equal(movement.to_frame, _STILL):
            frames.append(frame)
            absent.append(np.zeros(frame.shape, bool))
            continue
        dn, missing = _moved(frame, movement.to_frame)
        frames.append(replace(frame, dn=dn))
        absent.append(missing)
    return replace(bracket, light=tuple(frames)), absent


def _moved(frame: Frame, to_frame: Array) -> tuple[Any, NDArray[np.bool_]]:
    size, flags = (frame.shape[1], frame.shape[0]), cv2.WARP_INVERSE_MAP
    top, white = frame.full_scale_dn, frame.saturated_dn
    dn = cv2.warpAffine(frame.dn, to_frame, size, flags=flags | cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    np.minimum(dn, dn.dtype.type(top), out=dn)
    missing = _outside(frame.shape, to_frame)
    # A number means "clipped" only where all that it is read from clips.
    for end, clipped in ((0, frame.dn == 0), (top, frame.dn >= white)):
        if not clipped.any():
            continue
        mask = clipped.view(np.uint8) * np.uint8(255)
        share = cv2.warpAffine(mask, to_frame, size, flags=flags | cv2.INTER_LINEAR)
        np.putmask(dn, share == 255, end)
        if end == top:
            near = cv2.dilate(mask, np.ones((2 * _SUPPORT_PX + 1,) * 2, np.uint8))
            near = cv2.warpAffine(near, to_frame, size, flags=flags | cv2.INTER_NEAREST)
            missing |= (near > 0) & (dn != top)
    return dn, missing


def _outside(shape: tuple[int, int], to_frame: Array) -> NDArray[np.bool_]:
    """Return where a movement leads beyond the frame: in each row to the left of one place and right of another."""
    height, width = shape
    y, low, high = np.arange(height), np.zeros(height), np.full(height, width - 1.0)
    for (along_x, along_y, offset), last in zip(to_frame, (width - 1.0, height - 1.0), strict=True):
        start = along_y * y + offset
        if abs(along_x) * width < _PLACE_STEP_PX:  # the whole row leads to one place
            low[(start < -_PLACE_STEP_PX) | (start > last + _PLACE_STEP_PX)] = math.inf
            continue
        ends = np.sort([(-_PLACE_STEP_PX - start) / along_x, (last + _PLACE_STEP_PX - start) / along_x], axis=0)
        low, high = np.maximum(low, ends[0]), np.minimum(high, ends[1])
    x = np.arange(width, dtype=np.float32)
    return np.asarray((x < low[:, None]) | (x > high[:, None]))


def _reference(bracket: Bracket) -> int:
    """Return the frame that shows most of the scene between black and clipping."""
    shown = []
    for frame in bracket.light:
        low, high = math.floor(0.05 * frame.full_scale_dn) + 1, math.ceil(0.95 * frame.full_scale_dn) - 1
        shown.append(cv2.countNonZero(cv2.inRange(frame.dn, low, high)))
    return int(np.argmax(shown))


def _reduced(dn: Any, pixels: int) -> Image:
    height, width = dn.shape
    factor = math.sqrt(pixels / (height * width))
    if factor >= 1.0:
        return np.asarray(dn, np.float32)
    size = max(1, round(width * factor)), max(1, round(height * factor))
    return np.asarray(cv2.resize(dn.astype(np.float32), size, interpolation=cv2.INTER_AREA))


def _full_size(movement: Array, scale: float) -> Array:
    """Return a movement of reduced pictures for the full ones: the middle of a pixel is at (x + 1/2)·scale − 1/2."""
    half = np.full(2, 0.5 * (scale - 1.0))
    turn = movement[:, :2]
    return np.column_stack([turn, scale * movement[:, 2] + half - turn @ half])


def _after(second: Array, first: Array) -> Array:
    """Return the movement that is `first`, then `second`."""
    return np.column_stack([second[:, :2] @ first[:, :2], second[:, :2] @ first[:, 2] + second[:, 2]])


def _corners(shape: tuple[int, int]) -> Array:
    bottom, right = shape[0] - 1.0, shape[1] - 1.0
    return np.array([(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)])


def _pair_movement(here: Image, there: Image, inside: NDArray[np.uint8], full_scale_dn: int) -> _PairMovement | None:
    """Return the movement that takes pixels of the one picture to the other; None where there is no telling."""
    if min(here.shape) < _LEAST_SIDE_PX:
        return None
    still, other = _alike(here, there, inside, full_scale_dn)
    if still is None or other is None:
        return None
    levels = max(0, math.floor(math.log2(min(still.shape) / _COARSEST_PX)))
    pyramid = [(still, other, inside)]
    for _ in range(levels):
        a, b, mask = pyramid[-1]
        pyramid.append((cv2.pyrDown(a), cv2.pyrDown(b), np.ascontiguousarray(cv2.erode(mask, _NEIGHBOURS)[::2, ::2])))
    shifted = np.column_stack([np.eye(2), _shift(*pyramid[-1][:2])])
    coarsest = Climb(*pyramid[-1])
    _, found = max((_climbed(coarsest, start, _ITERATIONS) for start in (_STILL, shifted)), key=lambda one: one[0])
    for pictures in reversed(pyramid[1:-1]):
        found = _climbed(Climb(*pictures), _full_size(found, 2.0), _ITERATIONS_NEAR)[1]
    found = _full_size(found, 2.0 if levels else 1.0)
    # What moved through the scene pulls at the first estimate: it is left out of the last, and of the judgement.
    steady = inside & _steady(still, other, inside, found)
    reached, found = _summit(Climb(still, other, steady), found)
    if reached <= 0.0:
        return None
    return _believed(still, other, steady, found)


def _climbed(pair: Climb, start: Array, iterations: int) -> tuple[float, Array]:
    """Return the highest correlation of two pictures near a movement, and the movement there; −1 where it has none."""
    try:
        return pair.climbed(start, iterations)
    except MeasurementError:
        return -1.0, start


def _summit(pair: Climb, start: Array) -> tuple[float, Array]:
    """Return the highest correlation near a movement that is nearly right, and the movement there.

    Where few grey values or a mask make the correlation uneven the steps may go to and fro between two places: the
    better of the two is taken.
    """
    reached, last = _climbed(pair, start, _ITERATIONS_NEAR)
    if reached < 0.0:
        return reached, last
    at_last, following = _climbed(pair, last, 1)
    if Movement(_STILL + following - last).largest_px(pair.shape) < _ARRIVED_PX:
        return at_last, last
    at_following, _ = _climbed(pair, following, 1)
    return max((at_last, last), (at_following, following), key=lambda one: one[0])


def _believed(a: Image, b: Image, steady: NDArray[np.uint8], movement: Array) -> _PairMovement:
    """Return a movement with its uncertainty, or no movement where it improves nothing."""
    size, flags = (a.shape[1], a.shape[0]), cv2.WARP_INVERSE_MAP
    # Beyond the edge is black, which the blur draws in: up to the edges a high pedestal hides the improvement. With
    # the edge repeated there, half a pixel is believed of a camera that stood still and shows but stray light.
    moved = cv2.warpAffine(b, movement, size, flags=flags | cv2.INTER_LINEAR)
    shown = cv2.warpAffine(steady, movement, size, flags=flags | cv2.INTER_NEAREST) & steady
    smooth = [cv2.GaussianBlur(one, (BLUR_PX, BLUR_PX), 0) for one in (a, moved, b)]
    after, before = (float(np.mean((one - smooth[0])[shown > 0] ** 2)) for one in smooth[1:])
    mends = after <= _LEAST_GAIN * before
    return _PairMovement(movement if mends else _STILL, _corner_u_px(a, moved, shown, after), mends)


def _inside(picture: Image, rim_dn: float = 0.0) -> NDArray[np.uint8]:
    """Return 1 where a picture shows something: a rim is what another program left when it turned it."""
    near = cv2.dilate(_rim(picture, rim_dn).astype(np.uint8), np.ones((2 * BLUR_PX + 1,) * 2, np.uint8))
    return np.asarray(1 - near, np.uint8)


def _rim(picture: Image, dn: float) -> NDArray[np.bool_]:
    """Return what has one value, black or white, and hangs together with an edge of the picture."""
    alike = (picture <= dn) if dn <= 0.0 else (picture >= dn)
    count, label = cv2.connectedComponents(alike.astype(np.uint8))
    rim = np.zeros(count, bool)
    for edge in (label[0], label[-1], label[:, 0], label[:, -1]):
        rim[edge] = True
    rim[0] = False  # what has another value
    return np.asarray(rim[label])


def _has_white_rims(pictures: Sequence[Image], top: int) -> bool:
    """Return whether white at the edges is a rim, in a colour filled with white: no light clips in one frame only.

    Args:
        pictures: From the shortest exposure to the longest; what clips in one does in the last.
        top: Full scale in DN.
    """
    longest = pictures[-1]
    rims = (_rim(picture, top) for picture in pictures[:-1])
    return any(rim.mean() >= _LEAST_RIM and np.mean(longest[rim] < top) > _MOST_MOVED_WHITE for rim in rims)


def _corner_u_px(a: Image, b: Image, inside: NDArray[np.uint8], difference: float) -> float:
    """Return the standard uncertainty in pixels of a corner's place, from the mean square difference that stays.

    The difference is linear in small shifts and turns: the slopes of the picture are its derivatives, and what they
    hold in both pictures is no noise. What the two do not share is taken to be alike within the blur, so that so many
    pixels count as one. The most informative part of the picture is left out: one lamp in the dark shows nothing of
    the far corners.

    Args:
        a: The one picture.
        b: The other, brought to its place.
        inside: 1 where they show something.
        difference: Mean square difference.
    """
    pairs = zip(*(_parts(_derivatives(one) * inside) for one in (a, b)), strict=True)
    parts = [one @ two.T for one, two in pairs]
    best = max(parts, key=lambda part: part[0, 0] + part[1, 1])
    information = (np.sum(parts, axis=0) - best) / (max(difference, 1e-12) * _ALIKE_PX)
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    if values[0] <= 1e-12 * values[-1]:
        return math.inf
    u2 = np.sum(vectors**2 / values, axis=1)
    return math.sqrt(u2[0] + u2[1] + u2[2])


def _parts(planes: Image) -> Iterator[Array]:
    """Yield the pixels of every part of a picture, shape (planes, pixels) each."""
    for rows in np.array_split(planes, _PARTS, axis=1):
        for part in np.array_split(rows, _PARTS, axis=2):
            yield part.reshape(len(planes), -1).astype(np.float64)


def _derivatives(picture: Image) -> Image:
    """Return by what shifts in x and y, and a turn that moves the corners by a pixel, change a picture."""
    height, width = picture.shape
    down, right = np.gradient(cv2.GaussianBlur(picture, (BLUR_PX, BLUR_PX), 0))
    half_diagonal = 0.5 * math.hypot(height, width)
    y, x = (
        ((place - 0.5 * size) / half_diagonal).astype(np.float32)
        for place, size in zip(np.ogrid[:height, :width], picture.shape, strict=True)
    )
    return np.stack([right, down, x * down - y * right])


def _alike(
    here: Image, there: Image, inside: NDArray[np.uint8], full_scale_dn: int
) -> tuple[Image | None, Image | None]:
    """Return both pictures in the values of the darker one, cut off where the brighter one clips."""
    if not inside.any():
        return None, None
    swapped = float(here.mean()) > float(there.mean())
    dark, bright = (there, here) if swapped else (here, there)
    top = 0.97 * full_scale_dn
    # The values are resolved to so many steps, 1/257 DN of 8 bits: counted so, no picture need be sorted.
    step_dn = full_scale_dn / (_STEPS - 1)
    steps = [np.rint(one * (1.0 / step_dn)).astype(np.uint16) for one in (dark, bright)]
    counts = [cv2.calcHist([one], [0], inside, [_STEPS], [0, _STEPS]).ravel() for one in steps]
    share = float(counts[1][: math.ceil(top / step_dn)].sum() / counts[1].sum())
    levels, ends = (_quantiles(one, np.linspace(0.0, 1.0, 1025)) * step_dn for one in counts)
    end = float(_quantiles(counts[0], np.array([share]))[0]) * step_dn
    if share < _LEAST_SHARE or end - levels[0] < 3.0 / 255.0 * full_scale_dn:
        return None, None
    ends, first = np.unique(ends, return_index=True)
    # A level that many pixels share is matched by the middle of its ranks.
    last = np.append(first[1:], levels.size) - 1
    of_step = np.interp(step_dn * np.arange(_STEPS), ends, 0.5 * (levels[first] + levels[last]))
    matched = np.minimum(of_step, end).astype(np.float32)[steps[1]]
    cut = np.minimum(dark, end)
    return (matched, cut) if swapped else (cut, matched)


def _quantiles(counts: NDArray[np.float32], shares: Array) -> Array:
    """Return the whole numbers below which these shares of the counted ones are, interpolated linearly.

    Source: R. J. Hyndman, Y. Fan 1996, The American Statistician 50, 361–365, definition 7.
    """
    up_to = np.cumsum(counts, dtype=np.float64)
    place = shares * (up_to[-1] - 1.0)
    below = np.floor(place)
    low, high = (np.searchsorted(up_to, np.minimum(rank, up_to[-1] - 1.0), "right") for rank in (below, below + 1.0))
    return np.asarray(low + (high - low) * (place - below))


def _shift(a: Image, b: Image) -> Array:
    """Return the translation that takes pixels of one small picture to another, by phase correlation."""
    window = cv2.createHanningWindow((a.shape[1], a.shape[0]), cv2.CV_32F)
    # OpenCV leaves its window in pictures whose sides are a transform's.
    (x, y), response = cv2.phaseCorrelate(a.copy(), b.copy(), window)
    far = max(abs(x) / a.shape[1], abs(y) / a.shape[0]) > 0.25
    return np.array([0.0, 0.0]) if far or response < 0.05 else np.array([x, y])


def _steady(a: Image, b: Image, inside: NDArray[np.uint8], movement: Array) -> NDArray[np.uint8]:
    """Return 1 where the second picture, at its own place, shows what the first shows within the noise.

    The noise is that of the smaller nine tenths of the differences, counted as a normal distribution's. Where both are
    cut off they do not differ, whatever the noise.
    """
    size, flags = (a.shape[1], a.shape[0]), cv2.WARP_INVERSE_MAP | cv2.INTER_LINEAR
    smooth = [cv2.GaussianBlur(one, (BLUR_PX, BLUR_PX), 0) for one in (a, b)]
    smooth[1] = cv2.warpAffine(smooth[1], movement, size, flags=flags)
    gap = smooth[1] - smooth[0]
    below = np.minimum(*smooth) < float(a.max()) * (1.0 - 1e-5)
    shown = (cv2.warpAffine(inside.astype(np.float32), movement, size, flags=flags) > 0.999) & (inside > 0)
    size_of_gap = np.abs(gap)
    seen = size_of_gap[shown & below]
    kept = max(1, int(_KEPT * seen.size))
    square = np.partition(seen, kept - 1)[:kept].astype(np.float64) ** 2 if seen.size else seen
    limit = _MOVED_SIGMA * math.sqrt(float(square.mean()) / _KEPT_VARIANCE) if seen.size else math.inf
    other = ((size_of_gap > limit) & shown).astype(np.uint8)
    near = cv2.dilate(other, np.ones((2 * BLUR_PX + 1,) * 2, np.uint8))
    there = cv2.warpAffine(near, movement, size, flags=cv2.INTER_NEAREST)
    return np.asarray(there == 0, np.uint8)
