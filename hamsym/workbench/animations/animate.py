"""Animations of trajectories: hamsym.animate.

Input:  a solution, solutions, a trajectory or a periodic orbit, and what to draw.
Output: frames at equal times, as a page that plays itself, a GIF or a film.
"""

from __future__ import annotations

import base64
import contextlib
import io
import itertools
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from PIL import Image

from hamsym.errors import FileError, InputError
from hamsym.plotting.figure import Figure
from hamsym.support.atomic import write_file
from hamsym.support.suggestions import checked_keywords
from hamsym.support.validation import require_number, require_positive, require_whole
from hamsym.workbench.animations.film import Film
from hamsym.workbench.animations.motion import Motion, motion_of
from hamsym.workbench.animations.scenes import Scene, scene_of
from hamsym.workbench.page_templates import page_template

_SECONDS, _FPS = 8.0, 25.0
_SLOWEST, _FASTEST = 0.01, 1_000.0  # frames a second; a GIF has 16 bits for each pause
_MOST_FRAMES = 2_000
_COLORS = 128  # of a picture of a page or a GIF
_SUFFIXES = (".html", ".gif", ".mp4")


class Animation:
    """Frames of a motion at equal times, from :func:`hamsym.animate`.

    In a notebook it shows itself as a player.

    Attributes
    ----------
    times : numpy.ndarray
        Time of each frame, shape (frames,).
    states : numpy.ndarray
        States that are drawn, shape (frames, members, dim); members is 1 for one trajectory.
    fps : float
        Frames per second.
    """

    def __init__(self, motion: Motion, scene: Scene, times: np.ndarray, fps: float, tail: float):
        self._film = Film(motion, scene, times, tail)
        self.times, self.states, self.fps = times, self._film.states, fps

    def __repr__(self) -> str:
        start, end = float(self.times[0]), float(self.times[-1])
        return (
            f"Animation({len(self.times)} frames, {self.seconds:.4g} s, t from {start:.6g} to "
            f"{end:.6g})"
        )

    @property
    def seconds(self) -> float:
        """How long it plays."""
        return len(self.times) / self.fps

    def frame(self, number: int) -> Figure:
        """Return the figure at one frame.

        Parameters
        ----------
        number : int
            From 0; negative numbers count from the end.

        Raises
        ------
        InputError
            If there is no such frame.
        """
        count = len(self.times)
        require_whole("number", number, -count, count - 1)
        self._film.draw(number % count)
        return self._film.figure

    def save(self, path: str | os.PathLike[str], *, dpi: float = 120, largest: float = 20) -> None:
        """Write a page that plays itself, a GIF or a film, by the ending of the name.

        The file has the old or the new content at any time.

        Parameters
        ----------
        path : path
            Ends with ``.html`` (one file, nothing is fetched from elsewhere), ``.gif``, or
            ``.mp4``, which needs ffmpeg: that of the system, or of the package imageio-ffmpeg.
        dpi : float
            Pixels for each inch; figures are 4.3 inches wide.
        largest : float
            Largest file, in units of 10^6 bytes.

        Raises
        ------
        InputError
            If the ending is another one, ffmpeg is not there, or the file would be too large.
        FileError
            If the file cannot be written.

        Examples
        --------
        >>> import hamsym, tempfile
        >>> trajectory = hamsym.integrate("p**2/2 - cos(theta)", [2, 0], (0, 8), "gauss4", dt=0.1)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder, "pendulum.gif")
        ...     animate(trajectory, frames=5).save(path)
        ...     Image.open(path).n_frames
        5
        """
        try:
            target = Path(path)
        except TypeError:
            raise InputError(f"path={path!r} is no path; give one such as 'orbit.html'") from None
        suffix = target.suffix.lower()
        if suffix not in _SUFFIXES:
            raise InputError(
                f"an animation cannot be written as '{target.name}'; give a name that ends "
                f"{', '.join(_SUFFIXES[:-1])} or {_SUFFIXES[-1]}"
            )
        require_positive("dpi", dpi)
        require_positive("largest", largest)
        content = {".html": self._page, ".gif": self._gif, ".mp4": self._mp4}[suffix](
            float(dpi), largest * 1e6
        )
        write_file(target, content)

    def _repr_html_(self) -> str:
        try:
            return self._html("player", 120, 20e6)
        except InputError as error:
            return f"<p>{error}</p>"

    # -- formats -----------------------------------------------------------------------------

    def _images(self, dpi: float) -> Iterator[Image.Image]:
        """Yield the frames in colours of one palette."""
        palette = self._palette(dpi)
        for pixels in self._film.pixels(dpi):
            picture = Image.fromarray(pixels).convert("RGB")
            yield picture.quantize(palette=palette, dither=Image.Dither.NONE)

    def _palette(self, dpi: float) -> Image.Image:
        """Colours of some frames side by side."""
        shown = np.linspace(0, len(self.times) - 1, 4).astype(int).tolist()
        strip = np.concatenate([p[..., :3] for p in self._film.pixels(dpi, shown)], axis=1)
        return Image.fromarray(strip).quantize(_COLORS)

    def _html(self, part: str, dpi: float, largest: float) -> str:
        frames, size, dimensions = [], 0, (0, 0)
        for picture in self._images(dpi):
            file = io.BytesIO()
            picture.save(file, "PNG")
            frames.append(base64.b64encode(file.getvalue()).decode())
            size, dimensions = size + len(frames[-1]), picture.size
            self._require_small(size * len(self.times) / len(frames), largest)
        texts = [self._film.time_text(t) for t in self.times]
        write = getattr(page_template("animation").module, part)
        return str(write(frames, texts, self.fps, *dimensions, self._film.title))

    def _page(self, dpi: float, largest: float) -> bytes:
        return self._html("page", dpi, largest).encode()

    def _gif(self, dpi: float, largest: float) -> bytes:
        images, file = self._images(dpi), io.BytesIO()
        first, duration = next(images), 1000 / self.fps
        first.save(file, "GIF", save_all=True, append_images=images, duration=duration, loop=0)
        self._require_small(file.tell(), largest)
        return file.getvalue()

    def _mp4(self, dpi: float, largest: float) -> bytes:
        program, frames = _ffmpeg(), self._film.pixels(dpi)
        first = next(frames)
        height, width, _ = first.shape
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "film.mp4")
            given = f"-f rawvideo -pix_fmt rgba -s {width}x{height} -r {self.fps:.6f} -i -"
            # An even number of pixels, in the format that browsers and telephones show.
            made = "-vf pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white -pix_fmt yuv420p"
            command = [program, "-loglevel", "error", *given.split(), *made.split(), str(file)]
            with Path(folder, "said").open("w+b") as said:
                run = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=said)
                assert run.stdin is not None
                with contextlib.suppress(BrokenPipeError), run.stdin as pipe:  # it has ended
                    for pixels in itertools.chain([first], frames):
                        pipe.write(pixels.tobytes())
                if run.wait():
                    said.seek(0)
                    reason = said.read().decode(errors="replace").strip().rpartition("\n")[2]
                    raise FileError(f"ffmpeg did not write the film: {reason}; save it as .html")
            content = file.read_bytes()
        self._require_small(len(content), largest)
        return content

    def _require_small(self, size: float, largest: float) -> None:
        if not size <= largest:
            raise InputError(
                f"the file takes about {size / 1e6:.3g} million bytes, more than largest="
                f"{largest / 1e6:g}; give fewer frames, a smaller dpi or a larger limit"
            )


@checked_keywords
def animate(
    result: Any,
    *names: Any,
    kind: str | None = None,
    points: Callable[..., Any] | None = None,
    rods: Sequence[tuple[int, int]] = (),
    lengths: Any = None,
    frames: int | None = None,
    seconds: float | None = None,
    fps: float | None = None,
    tail: float = 0.15,
) -> Animation:
    """Animate a solution, solutions, a trajectory or a periodic orbit.

    Frames are at equal times from the start to the end. Without ``names`` and ``kind`` the names of
    the coordinates suggest a picture: bodies of x, y or x1, y1, x2, y2, ... move in their plane,
    those of r, theta (rho, phi) in theirs if H has the term p_theta**2/r**2, angles theta or
    theta1, theta2 (phi, psi) with coupled momenta are those of a pendulum, three and more numbered
    coordinates those of a chain, and one coordinate moves in its phase plane.

    Parameters
    ----------
    result : Solution, Solutions, Trajectory or PeriodicOrbit
        Of many trajectories the first 50 are drawn.
    *names : str or sympy.Expr
        Two components or formulas in the names of H: a point in their plane; with four and more, a
        point for each two. Of a coordinate and its momentum with one degree of freedom, level sets
        of H are drawn too. A point is left out while its formula is no finite real number.
        With ``kind`` "polar" distances and angles, with "pendulum" the angles, with "chain" the
        displacements.
    kind : {"plane", "phase", "polar", "pendulum", "chain"}, optional
        Polar coordinates are a distance and an angle for each body; where H has a weight along
        the angle zero, that direction is vertical. A pendulum has a rod for each angle, measured
        from the vertical. A chain has its coordinates as heights above their numbers.
    points : callable, optional
        A function of the state, shape (dim,), or of the state and the time: places of points,
        shape (points, 2). It replaces names and kind.
    rods : sequence of (int, int)
        Pairs of these points that a rod joins.
    lengths : float, str or sequence, optional
        Of the rods of a pendulum: numbers or names of parameters. By default parameters l1, l2,
        ... or l, if H has them, else equal lengths.
    frames : int, optional
        Number of frames, up to 2,000.
    seconds : float, optional
        How long the animation plays, by default 8.
    fps : float, optional
        Frames per second, by default 25.
    tail : float
        Length of the fading tail, as a part of the span from 0 to 1.

    Returns
    -------
    Animation
        Save it with ``.save("x.html")``; in a notebook it shows itself.

    Raises
    ------
    InputError
        If the result has no motion, a name is unknown, no picture is suggested, or options do not
        fit together.

    Examples
    --------
    >>> import hamsym
    >>> pendulum = hamsym.Hamiltonian("p**2/(2*l**2) - l*cos(theta)", parameters={"l": 2.0})
    >>> solution = hamsym.solve(pendulum, [2.0, 0.0], (0, 20))
    >>> animation = animate(solution)
    >>> animation
    Animation(200 frames, 8 s, t from 0 to 20)
    >>> bool(np.allclose(animation.states[:, 0], solution(animation.times), rtol=0, atol=1e-12))
    True
    >>> animate(solution, points=lambda z: [[0, 0], [np.sin(z[0]), -np.cos(z[0])]], rods=[(0, 1)])
    Animation(200 frames, 8 s, t from 0 to 20)
    """
    motion = motion_of(result)
    count, rate = _timing(frames, seconds, fps)
    require_number("tail", tail, 0.0)
    if not tail <= 1:
        raise InputError(f"tail={tail!r} cannot be used; give a part of the span from 0 to 1")
    scene = scene_of(motion, names, kind, lengths, points, rods)
    start, end = motion.span
    times = np.linspace(start, end, count, endpoint=not motion.closed)
    return Animation(motion, scene, times, rate, float(tail))


def _timing(frames: int | None, seconds: float | None, fps: float | None) -> tuple[int, float]:
    """Return the number of frames and the frames per second."""
    if None not in (frames, seconds, fps):
        raise InputError("frames, seconds and fps determine each other; give two of them")
    for name, value in (("seconds", seconds), ("fps", fps)):
        if value is not None:
            require_positive(name, value)
    if frames is not None:
        require_whole("frames", frames, 2, _MOST_FRAMES)
        if seconds is not None:
            if not _SLOWEST <= frames / seconds <= _FASTEST:
                raise InputError(
                    f"{frames:,} frames in {seconds:g} seconds cannot be shown; give seconds for "
                    f"{_SLOWEST:g} to {_FASTEST:g} frames a second"
                )
            return frames, frames / seconds
        return frames, _FPS if fps is None else float(fps)
    rate = _FPS if fps is None else float(fps)
    count = (_SECONDS if seconds is None else seconds) * rate
    if not 2 <= count <= _MOST_FRAMES:
        raise InputError(
            f"{count:,.0f} frames cannot be drawn; give seconds and fps for 2 to {_MOST_FRAMES:,}"
        )
    return round(count), rate


def _ffmpeg() -> str:
    """Return the path of ffmpeg, of the system or of the package imageio-ffmpeg."""
    if found := shutil.which(matplotlib.rcParams["animation.ffmpeg_path"]):
        return found
    try:
        import imageio_ffmpeg  # an optional package

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        raise InputError(
            "a film needs ffmpeg, which is not installed; install it, or the package "
            "imageio-ffmpeg, or save the animation as .html or .gif"
        ) from None
