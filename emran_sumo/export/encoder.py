"""Encoding frames as a video by ffmpeg."""

import contextlib
import shutil
import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path

from emran_sumo.errors import UserError


def find_encoder() -> str:
    """The ffmpeg that the package imageio-ffmpeg brings, or the one on the PATH.

    Raises:
        UserError: there is neither.
    """
    try:
        import imageio_ffmpeg  # pyright: ignore[reportMissingImports]

        return imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        found = shutil.which("ffmpeg")
    if found is None:
        raise UserError('--format mp4: there is no ffmpeg; install it with: pip install "emran-sumo[video]"')
    return found


def encode(file: Path, encoder: str, frames: Iterable[bytes], size: tuple[int, int], rate: int) -> None:
    """Write frames of `size` (width, height; even) in RGB as H.264 at `rate` frames per second.

    Raises:
        UserError: the encoder fails; with its last words.
    """
    command = [
        encoder, "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}",
        "-r", str(rate), "-i", "-", "-an", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "21",
        "-movflags", "+faststart", "-f", "mp4", str(file),
    ]  # fmt: skip
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said)
        assert process.stdin is not None
        try:
            with contextlib.suppress(BrokenPipeError):  # it says why
                for frame in frames:
                    process.stdin.write(frame)
        except BaseException:
            process.kill()
            raise
        finally:
            with contextlib.suppress(BrokenPipeError):
                process.stdin.close()
            process.wait()
        if process.returncode:
            said.seek(0)
            words = said.read().decode(errors="replace").strip().splitlines()
            raise UserError(f"--format mp4: ffmpeg failed: {words[-1] if words else 'it said nothing'}")
