# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Pictures of recordings in the rerun viewer, drawn again with `docs/tools/recordings.py`.

On a screen, or without one, with the pointer next to the window:
`xvfb-run -a -s '-screen 0 6000x4000x24' python docs/tools/recordings.py`, some 30 s for each.
Each viewer has a port of its own: else one that runs would show the recording. Its own notices go
away after some seconds; look whether a fast machine has caught them.
"""

from pathlib import Path
import socket
import subprocess
import sys
from tempfile import TemporaryDirectory

from hnn_vi_ros import simulate
from PIL import Image

FOLDER = Path(__file__).resolve().parents[1] / 'how-to' / 'recordings'
# Scene, and simulated time [s].
SCENES = {'harmonic_oscillator': 20.0, 'spherical_pendulum': 10.0,
          'exact_damped_driven_pendulum': 3.0, 'six_joint_arm': 2.6}
_WINDOW, _WIDTH, _COLOURS = '1400x900', 1400, 256


def write_screenshot(name: str, duration: float, path: Path) -> None:
    """Simulate a scene, and save the viewer's picture of its recording."""
    with TemporaryDirectory() as folder:
        recording, shot = Path(folder) / f'{name}.rrd', Path(folder) / 'shot.png'
        simulate(name, duration).to_rerun(recording)
        with socket.socket() as probe:
            probe.bind(('', 0))
            port = str(probe.getsockname()[1])
        subprocess.run([sys.executable, '-m', 'rerun_cli', recording, '--window-size', _WINDOW,
                        '--screenshot-to', shot, '--port', port], check=True, timeout=600.0)
        picture = Image.open(shot).convert('RGB')
        picture.thumbnail((_WIDTH, _WIDTH), Image.Resampling.LANCZOS)
        # Every colour has its share, however few points it has: that of an arrow, or of a curve.
        # k-means, the mean of the pixels of a colour, leaves the background unchanged.
        picture.quantize(_COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=1,
                         dither=Image.Dither.NONE).save(path, optimize=True)


if __name__ == '__main__':
    FOLDER.mkdir(exist_ok=True)
    for scene in sys.argv[1:] or SCENES:
        write_screenshot(scene, SCENES[scene], FOLDER / f'{scene}.png')
