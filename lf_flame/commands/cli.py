"""The program `lf-flame`: thin commands over the package.

Heavy modules are imported inside the commands, so that ``--help`` answers at once.
"""

import click
import cloup

from lf_flame import __version__
from lf_flame.commands import (
    calibration,
    emission,
    files,
    learning,
    program,
    refocus,
    simulation,
    temperature,
    videos,
    viewer,
)
from lf_flame.commands.options import HELP, Program

TOUR = """Simulate, decode and refocus light fields; measure emission and flicker of flames.

\b
A first tour:
  lf-flame demo                     a simulated light field, in the browser
  lf-flame camera                   the camera of the paper in numbers
  lf-flame plan SCENE.toml          which physical effects a scene needs
  lf-flame simulate SCENE.toml      your own scene, as pictures
  lf-flame info FILE                what a file is, and what to type next
  lf-flame refocus FOLDER           any light field, refocused
  lf-flame view FOLDER              the same in the browser, by a focus slider

Details of each command: lf-flame COMMAND --help; all of its options: --help-all.
"""

SECTIONS = [
    cloup.Section("Simulation", [files.camera, simulation.plan, simulation.simulate]),
    cloup.Section(
        "Light fields", [viewer.demo, files.info, viewer.view, refocus.refocus, files.convert]
    ),
    cloup.Section("Calibration", [calibration.calibrate, calibration.calibrate_colours]),
    cloup.Section(
        "Emission",
        [emission.reconstruct, emission.abel, temperature.profiles, temperature.temperature],
    ),
    cloup.Section("Videos", [videos.flicker, videos.process]),
    cloup.Section(
        "Networks", [learning.dataset, learning.train, learning.predict, learning.train_system]
    ),
]


@cloup.group(cls=Program, help=TOUR, context_settings=HELP, sections=SECTIONS, align_sections=True)
@click.version_option(__version__)
def commands() -> None:
    """Group the commands."""


def main() -> None:
    """Run the program."""
    program.run(commands, "lf-flame")
