"""The program `lf-flame`: thin commands over the package.

Heavy modules are imported inside the commands, so that ``--help`` answers at once.
"""

import click
import cloup

from lf_flame import __version__
from lf_flame.commands import (
    calibration,
    colours,
    datasets,
    info,
    light_fields,
    networks,
    profiles,
    program,
    simulation,
    systems,
    temperature,
    tomography,
    videos,
    viewer,
)
from lf_flame.commands.options import HELP, Program

TOUR = """Simulate a plenoptic camera, refocus light fields, and train networks to do it.

\b
A first tour:
  lf-flame demo                     a simulated light field, in the browser
  lf-flame camera                   the camera of the paper in numbers
  lf-flame plan SCENE.toml          which physical effects a scene needs
  lf-flame simulate SCENE.toml      your own scene, as pictures
  lf-flame info FILE                what a file is, and what to type next
  lf-flame refocus FOLDER           any light field, refocused
  lf-flame view FOLDER              the same in the browser, by a focus slider

Details of each command: lf-flame COMMAND --help.
"""

SECTIONS = [
    cloup.Section("Simulation", [simulation.camera, simulation.plan, simulation.simulate]),
    cloup.Section(
        "Light fields",
        [
            viewer.demo,
            info.info,
            viewer.view,
            light_fields.refocus,
            light_fields.convert,
            calibration.calibrate,
            colours.calibrate_colours,
        ],
    ),
    cloup.Section(
        "Emission by depth",
        [
            tomography.resolution,
            tomography.reconstruct,
            tomography.abel,
            profiles.profiles,
            temperature.temperature,
        ],
    ),
    cloup.Section("Videos", [videos.flicker, videos.process, videos.status]),
    cloup.Section("Data sets", [datasets.dataset]),
    cloup.Section(
        "The paper's network",
        [networks.train, networks.predict],
    ),
    cloup.Section("Refocusing systems", [systems.train_system]),
]


@cloup.group(cls=Program, help=TOUR, context_settings=HELP, sections=SECTIONS, align_sections=True)
@click.version_option(__version__)
def commands() -> None:
    """Group the commands."""


def main() -> None:
    """Run the program."""
    program.run(commands, "lf-flame")
