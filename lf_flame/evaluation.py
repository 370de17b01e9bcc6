"""SSIM and PSNR of a trained model on its test split, and the tables made of them."""

from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from lf_flame import provenance
from lf_flame.config import read_record
from lf_flame.datasets import Dataset, split_indices
from lf_flame.errors import InputError
from lf_flame.files import write_json, write_text
from lf_flame.keras_loading import load_model
from lf_flame.paper import read_paper_values

COLUMNS = [
    "depth_mm", "object", "ssim", "ssim_sd", "psnr_db", "psnr_sd", "paper_ssim", "paper_psnr_db",
    "n_test", "psnr_lit_db", "psnr_lit_sd",
]  # fmt: skip

TABLES = ("table1", "table2")

LIT = 0.01
"""Truth above which a pixel is lit, of the peak 1. Two thirds of the pixels are background, black
in the truth and easily so in a prediction: taken in, they dilute the error of the objects, and PSNR
comes out 4 to 6 dB higher, the more so the smaller the object."""


def ssim(truth: np.ndarray, image: np.ndarray) -> float:
    """Structural similarity as Wang et al. (2004) define it, for values in [0, 1].

    Of colours, a third axis, the mean over the channels.
    Gaussian window of standard deviation 1.5 pixels, K1 = 0.01, K2 = 0.03, population covariance:
    the paper does not state its constants (deviation 12).
    """
    return structural_similarity(
        truth, image, data_range=1.0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
        channel_axis=-1 if np.ndim(truth) == 3 else None,
    )  # fmt: skip


def _uniform_ssim(side: int):
    """SSIM in a square window of equal weights, scikit-image's other constants."""
    return partial(structural_similarity, data_range=1.0, win_size=side)


WINDOWS = {
    "Gaussian, 1.5 pixels (the table's)": ssim,
    "7 x 7, scikit-image's default": _uniform_ssim(7),
    "11 x 11": _uniform_ssim(11),
}
"""Windows of the structural similarity."""


def psnr(truth: np.ndarray, image: np.ndarray) -> float:
    """Peak signal-to-noise ratio in dB for values in [0, 1]; infinite for equal images."""
    with np.errstate(divide="ignore"):
        return peak_signal_noise_ratio(truth, image, data_range=1.0)


def psnr_lit(truth: np.ndarray, image: np.ndarray) -> float:
    """`psnr` whose mean squared error runs over the lit pixels alone; NaN where none is lit."""
    lit = truth > LIT
    return psnr(truth[lit], image[lit]) if lit.any() else np.nan


def score(targets: np.ndarray, predictions: np.ndarray) -> pd.DataFrame:
    """Score every plane over all samples.

    Parameters
    ----------
    targets, predictions : ndarray, shape (n, planes, h, w) or (n, planes, h, w, channels)

    Returns
    -------
    DataFrame
        One row a plane: mean and standard deviation (over the samples, n - 1) of SSIM, of PSNR,
        and of PSNR over the lit pixels, where samples without any are left out.
    """
    measures = {"ssim": ssim, "psnr_db": psnr, "psnr_lit_db": psnr_lit}
    rows = []
    for truths, images in zip(
        np.swapaxes(targets, 0, 1), np.swapaxes(predictions, 0, 1), strict=True
    ):
        row = {"n_test": len(truths)}
        for name, measure in measures.items():
            values = pd.Series([measure(a, b) for a, b in zip(truths, images, strict=True)])
            row |= {name: values.mean(), f"{name.removesuffix('_db')}_sd": spread(values)}
        rows.append(row)
    return pd.DataFrame(rows)


def spread(values: pd.Series) -> float:
    """Take the standard deviation (n - 1), where equal images may make a PSNR infinite.

    Infinite values among finite ones spread infinitely, infinite ones alone not at all; pandas
    would take the difference of two infinite numbers. NaN is left out.
    """
    values = values.dropna()
    if len(values) < 2 or np.all(np.isfinite(values)):
        return values.std()
    return 0.0 if np.all(np.isinf(values)) else np.inf


def load_run(folder: str | Path) -> dict:
    """Read the record of a finished run.

    Raises
    ------
    InputError
        If the run is missing or not finished, or its record is damaged.
    """
    folder = Path(folder)
    if not (folder / "model.keras").exists() or not (folder / "run.json").exists():
        raise InputError(f"There is no finished run in {folder}; train it first.")
    return read_record(folder / "run.json")


def open_run(folder: str | Path) -> tuple[dict, Dataset]:
    """Read the record of a finished run, and open the data set that it was trained on.

    Raises
    ------
    InputError
        If the run is missing or not finished, is of something else, or the data set is no longer
        the same.
    """
    run = load_run(folder)
    if "data" not in run:
        raise InputError(f"{folder} holds no run of the paper's network.")
    dataset = Dataset(run["data"])
    if dataset.attrs["sha256"] != run["data_sha256"]:
        raise InputError(
            f"{run['data']} is not the data set that {folder} was trained on; train it again."
        )
    return run, dataset


def predict_test_split(folder: str | Path) -> tuple[Dataset, np.ndarray, np.ndarray]:
    """Run the whole trained network, backbone included, over the test split of its data set.

    Returns
    -------
    Dataset
    ndarray of int, shape (n,)
        Indices of the test samples.
    ndarray of float32, shape (n, planes, h, w)
    """
    run, dataset = open_run(folder)
    indices = np.array(run["test_indices"])
    model = load_model(Path(folder) / "model.keras")
    stack = model.predict(dataset.inputs[indices], batch_size=8, verbose=0)
    return dataset, indices, stack[..., 0]


def compare_with_paper(scores: pd.DataFrame, paper: dict) -> pd.DataFrame:
    """Put the paper's values beside ours; columns as in `COLUMNS`."""
    if len(scores) != len(paper["depth_mm"]):
        raise InputError(
            f"The paper has {len(paper['depth_mm'])} planes, the model has {len(scores)}."
        )
    table = scores.assign(
        depth_mm=paper["depth_mm"],
        object=paper["object"],
        paper_ssim=paper["ssim"],
        paper_psnr_db=paper["psnr_db"],
    )
    return table[COLUMNS]


def score_windows(targets: np.ndarray, predictions: np.ndarray) -> pd.DataFrame:
    """Score SSIM by the table's window and by others: the paper does not state its own.

    Parameters
    ----------
    targets, predictions : ndarray, shape (n, planes, h, w)

    Returns
    -------
    DataFrame
        One row a window, one column a plane: the mean over the samples.
    """
    pairs = list(zip(targets, predictions, strict=True))
    rows = {
        window: np.mean(
            [[measure(a, b) for a, b in zip(*pair, strict=True)] for pair in pairs], axis=0
        )
        for window, measure in WINDOWS.items()
    }
    return pd.DataFrame.from_dict(rows, orient="index")


def windows_markdown(windows: pd.DataFrame, depths_mm: list[float]) -> str:
    """One row a window; the mean SSIM for each depth."""
    shown = windows.map("{:.4f}".format).set_axis([f"{z:g} mm" for z in depths_mm], axis=1)
    lines = shown.to_markdown(disable_numparse=True, stralign="right")
    return f"SSIM of the same images by other windows:\n\n{lines}\n"


def score_baselines(dataset: Dataset, train: np.ndarray, test: np.ndarray) -> pd.DataFrame:
    """Score what needs no network: the mean training image, and the input image as it is.

    The latter where the input is one image of the targets' size.

    Returns
    -------
    DataFrame
        One row a plane and baseline; columns ``baseline``, ``depth_mm``, ``ssim``, ``psnr_db``,
        ``psnr_lit_db``.
    """
    targets = dataset.targets[test]
    mean = np.broadcast_to(dataset.targets[train].mean(axis=0), targets.shape)
    baselines = [("mean of the training images", mean)]
    if dataset.inputs.shape[1:] == (*targets.shape[2:], 1):
        copied = np.broadcast_to(np.moveaxis(dataset.inputs[test], 3, 1), targets.shape)
        baselines.append(("the input image", copied))
    tables = []
    for name, images in baselines:
        scores = score(targets, images)
        tables.append(scores.assign(baseline=name, depth_mm=dataset.config.depths_mm))
    return pd.concat(tables)[["baseline", "depth_mm", "ssim", "psnr_db", "psnr_lit_db"]]


def baselines_markdown(baselines: pd.DataFrame) -> str:
    """One row a baseline; SSIM / PSNR / PSNR over the lit pixels for each depth."""
    numbers = baselines[["ssim", "psnr_db", "psnr_lit_db"]].itertuples(index=False)
    cells = baselines.assign(cell=["{:.3f} / {:.2f} / {:.2f}".format(*row) for row in numbers])
    shown = cells.pivot(index="baseline", columns="depth_mm", values="cell")
    shown = shown[baselines.depth_mm.unique()]
    shown.columns = [f"{depth:g} mm" for depth in shown.columns]
    lines = shown.to_markdown(disable_numparse=True, stralign="right")
    return (
        f"Without a network, SSIM / PSNR / PSNR over the lit pixels (dB) on the same test split:"
        f"\n\n{lines}\n"
    )


def table_markdown(table: pd.DataFrame | None, paper: dict, run: dict | None) -> str:
    """Write a table as Markdown: ours, the paper's, the difference; a missing run as missing."""
    if table is None:
        shown = pd.DataFrame(
            {
                "depth (mm)": paper["depth_mm"],
                "object": paper["object"],
                "SSIM": "missing",
                "SSIM, paper": paper["ssim"],
                "PSNR (dB)": "missing",
                "PSNR, paper": paper["psnr_db"],
            }
        )
        note = "No finished run: `make tables` makes it."
    else:
        shown = pd.DataFrame(
            {
                "depth (mm)": table.depth_mm,
                "object": table.object,
                "SSIM": _with_spread(table.ssim, table.ssim_sd, 3),
                "SSIM, paper": table.paper_ssim,
                "difference": (table.ssim - table.paper_ssim).map("{:+.3f}".format),
                "PSNR (dB)": _with_spread(table.psnr_db, table.psnr_sd, 2),
                "PSNR, paper": table.paper_psnr_db,
                "difference ": (table.psnr_db - table.paper_psnr_db).map("{:+.2f}".format),
                "PSNR, lit (dB)": _with_spread(table.psnr_lit_db, table.psnr_lit_sd, 2),
            }
        )
        note = (
            f"Mean ± standard deviation over {table.n_test[0]} test samples; lit: over the pixels "
            f"brighter than {LIT:.0%} of the peak in the truth. "
            f"Preset {run['preset']}: {run['epochs']} epochs (best: {run['best_epoch']}), batch "
            f"{run['recipe']['batch_size']}; backbone weights: {run['backbone_weights']}; "
            f"trained in {run['train_s']:.0f} s on {run['machine']}."
        )
    lines = shown.to_markdown(index=False, disable_numparse=True, stralign="right")
    return f"### {paper['title']}\n\n{lines}\n\n{note}\n"


def _with_spread(mean: pd.Series, spread: pd.Series, digits: int) -> list[str]:
    return [f"{m:.{digits}f} ± {s:.{digits}f}" for m, s in zip(mean, spread, strict=True)]


def write_table(
    table: pd.DataFrame,
    baselines: pd.DataFrame,
    windows: pd.DataFrame,
    paper: dict,
    run: dict,
    name: str,
    out: Path,
) -> None:
    """Write ``NAME.json``, ``NAME.md`` and, last because make looks at it, ``NAME.csv``."""
    evaluation = provenance.environment()
    # What was asked for as weights may not be what was had; `backbone_weights` is what was used.
    model = {key: value for key, value in run["model"].items() if key != "backbone_weights"}
    record = {
        **{key: value for key, value in run.items() if key != "test_indices"},
        "model": model,
        "table": table.to_dict("records"),
        "baselines": baselines.to_dict("records"),
        "ssim_by_window": {window: list(row) for window, row in windows.T.items()},
        "paper": paper["source"],
        "evaluation": {key: evaluation[key] for key in ("command", "date", "git_revision")},
    }
    write_json(out / f"{name}.json", record)
    parts = [
        table_markdown(table, paper, run),
        baselines_markdown(baselines),
        windows_markdown(windows, paper["depth_mm"]),
    ]
    write_text(out / f"{name}.md", "\n".join(parts))
    write_text(out / f"{name}.csv", table.round(6).to_csv(index=False))


def training_indices(samples: int, run: dict) -> np.ndarray:
    """Find the samples that a run was trained on."""
    return split_indices(samples, run["split"], run["seed"])["train"]


def read_tables(out: Path, paper_values: Path) -> str:
    """Both tables of a results folder as Markdown, missing ones shown as missing."""
    texts = []
    for name in TABLES:
        found = out / f"{name}.md"
        if found.exists():
            texts.append(found.read_text(encoding="utf-8"))
        else:
            texts.append(table_markdown(None, read_paper_values(paper_values, name), None))
    return "\n".join(texts)
