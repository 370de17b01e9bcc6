"""What lies within cells, against courses of light that are known there."""

import numpy as np
from scipy.special import erf

from lf_flame.tomography.cell_detail import FINER, cell_means, smooth_course


def blob_means(edges, middle, width):
    """Means of a Gaussian between edges."""
    return np.diff(np.sqrt(np.pi) / 2 * width * erf((edges - middle) / width)) / np.diff(edges)


def test_a_course_keeps_the_light_of_each_cell():
    rng = np.random.default_rng(3)
    plane = rng.uniform(1, 2, (8, 11))
    course = smooth_course(plane)
    assert course.shape == (8 * FINER, 11 * FINER)
    # Noise from cell to cell is the worst there is; what is smooth is kept ten times better.
    assert np.abs(cell_means(course) - plane).max() < 0.02
    bend = np.outer(1 + np.sin(np.arange(8) / 3), 2 + np.cos(np.arange(11) / 3))
    assert np.abs(cell_means(smooth_course(bend)) - bend).max() < 2e-3


def test_a_smooth_blob_is_followed_within_its_cells():
    edges = np.arange(13.0)
    fine = np.arange(12 * FINER + 1) / FINER
    means, truth = (
        np.outer(blob_means(some, 5.7, 3.0), blob_means(some, 6.4, 2.5)) for some in (edges, fine)
    )
    even = np.kron(means, np.ones((FINER, FINER)))
    inside = slice(3 * FINER, -3 * FINER), slice(3 * FINER, -3 * FINER)  # no cells beyond the edge
    off = np.abs(smooth_course(means) - truth)[inside].max()
    assert off < 0.01 * np.abs(even - truth)[inside].max()


def test_no_light_is_below_zero_and_darkness_stays_dark():
    plane = np.zeros((7, 7))
    assert not smooth_course(plane).any()
    plane[3, 3] = 1.0
    assert smooth_course(plane).min() >= 0
