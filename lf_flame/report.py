"""What the program prints and writes: reports put together from the parts of the package."""

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import pandas as pd
from tqdm import tqdm

from lf_flame import provenance
from lf_flame.camera import PlenopticCamera
from lf_flame.config import to_json
from lf_flame.datasets import DatasetConfig, search_slopes
from lf_flame.files import write_json, write_text
from lf_flame.paper import read_paper_values


def progress_bar(finished: Iterable, done: int, total: int) -> Iterator:
    """Show a bar with the time left over samples that are already done and those to come."""
    return tqdm(finished, "simulating", total, initial=done, unit="sample", smoothing=0.1)


def step_bar(finished: Iterable, done: int, total: int) -> Iterator:
    """Show a bar over the steps of a study."""
    return tqdm(finished, "measuring", total, initial=done, unit="step")


def camera_report(camera: PlenopticCamera, depths_mm: Iterable[float]) -> str:
    """Table of the numbers that follow from a camera, and of the slopes at some depths."""
    fov, field = camera.field_of_view_deg, camera.field_mm(0.0)
    rows = [
        ("main lens focal length", f"{camera.main_lens_focal_mm:g} mm"),
        ("focal plane to main lens", f"{camera.focus_distance_mm:g} mm"),
        ("main lens to microlens array", f"{camera.image_distance_mm:.3f} mm (thin lens)"),
        ("magnification", f"{-camera.image_distance_mm / camera.focus_distance_mm:.4f}"),
        ("aperture, f-number matched", f"{camera.aperture_mm:.2f} mm"),
        ("view step on the main lens", f"{camera.view_step_mm:.3f} mm"),
        ("lenslets (rows x columns)", f"{camera.lenslets[0]} x {camera.lenslets[1]}"),
        ("views", f"{camera.views} x {camera.views}"),
        ("pixel pitch", f"{camera.pixel_mm * 1e3:.3f} um"),
        ("field of view (down x across)", f"{fov[0]:.2f} x {fov[1]:.2f} degrees"),
        ("field at the focal plane", f"{field[0]:.2f} x {field[1]:.2f} mm"),
    ]
    numbers = pd.DataFrame(rows, columns=["camera", "value"])
    layers = pd.DataFrame({"depth (mm)": [f"{z:g}" for z in depths_mm]})
    slopes = [camera.depth_to_slope(z) for z in depths_mm]
    layers["slope (lenslets per view)"] = [f"{s:+.3f}" for s in slopes]
    layers["alpha"] = [f"{camera.slope_to_alpha(s):.4f}" for s in slopes]
    fields = [camera.field_mm(z) for z in depths_mm]
    layers["field (mm)"] = [f"{height:.2f} x {width:.2f}" for height, width in fields]
    style = {"index": False, "disable_numparse": True, "tablefmt": "simple"}
    return f"{numbers.to_markdown(**style)}\n\n{layers.to_markdown(**style)}"


def slope_report(configs: list[DatasetConfig], paper_values: Path, out: Path | None) -> str:
    """Search the slopes of data-set templates; write and return the table.

    Writes ``slopes.png``, ``slopes.md``, ``slopes.json`` and ``slopes.csv`` into `out`.
    """
    from lf_flame import figures

    printed = read_paper_values(paper_values, "slopes")
    paper = dict(zip(printed["depth_mm"], printed["slope"], strict=True))
    rows, records, panels = [], [], {}
    for config in configs:
        searches = search_slopes(config)
        records.append({"config": to_json(config), "slopes": [s.slope for s in searches]})
        layers = panels.setdefault(f"{config.kind}: mean scene", [])
        for item, search in zip(config.template.objects, searches, strict=True):
            geometry = config.camera.depth_to_slope(item.depth_mm)
            printed_slope = paper.get(item.depth_mm, math.nan)
            rows.append(
                (config.kind, item.name, item.depth_mm, search.slope, geometry,
                 search.slope - geometry, printed_slope)
            )  # fmt: skip
            label = f"{item.name} at {item.depth_mm:g} mm"
            layers.append((label, search, geometry, printed_slope))
    columns = ["data_set", "object", "depth_mm", "slope", "geometry", "difference", "paper"]
    table = pd.DataFrame(rows, columns=columns).round(4).replace(-0.0, 0.0)
    text = (
        f"### {printed['title']} (lenslets per view step)\n\n"
        + table.to_markdown(index=False, floatfmt=("", "", "g", ".4f", ".4f", "+.4f", ".2f"))
        + "\n\nFound by gradient energy on the mean scene; geometry: the camera's closed form.\n"
    )
    if out is not None:
        figures.save(figures.sharpness_figure(panels), out / "slopes.png")
        write_json(out / "slopes.json", {"data_sets": records, **provenance.environment()})
        write_text(out / "slopes.md", text)
        write_text(out / "slopes.csv", table.to_csv(index=False))
    return text


def compare_runs(folders: Sequence[Path], paper_values: Path, out: Path | None) -> str:
    """Set the tables of results folders side by side; with `out`, keep them and draw the learning.

    Parameters
    ----------
    folders, paper_values, out
        See `lf_flame.comparison.report_tables`. Beside `out`, NAME.md, goes NAME.png: validation
        PSNR against seconds.
    """
    from lf_flame import comparison

    text = comparison.report_tables(folders, paper_values, out)
    if out is not None:
        from lf_flame import figures

        panels, printed = {}, {}
        for name in comparison.TABLES:
            paper = read_paper_values(paper_values, name)
            panels[paper["title"]] = comparison.read_histories(folders, name)
            printed[paper["title"]] = paper["psnr_db"]
        figures.save(figures.learning_figure(panels, printed), out.with_suffix(".png"))
    return text


def evaluate_run(run: Path, table: str, figure: str, paper_values: Path, out: Path) -> None:
    """Score a run's test split; write its table and the figure of its first test sample."""
    from lf_flame import evaluation, figures

    record = evaluation.load_run(run)
    paper = read_paper_values(paper_values, table)
    tqdm.write(f"Scoring {record['parts']['test']} test samples of {run}")
    dataset, indices, predictions = evaluation.predict_test_split(run)
    record["scenes_sha256"] = dataset.scenes_sha256
    targets = dataset.targets[indices]
    scores = evaluation.compare_with_paper(evaluation.score(targets, predictions), paper)
    picture = figures.result_figure(
        dataset.inputs[indices[0]].squeeze(),
        targets[0],
        predictions[0],
        dataset.config.depths_mm,
        f"{record['title']}: sample {indices[0]}, the first of the test split ({record['preset']}, "
        f"backbone {record['backbone_weights']})",
    )
    figures.save(picture, out / f"{figure}.png")
    train = evaluation.training_indices(len(dataset), record)
    baselines = evaluation.score_baselines(dataset, train, indices)
    write_text(out / f"{table}_history.csv", (run / "history.csv").read_text(encoding="utf-8"))
    windows = evaluation.score_windows(targets, predictions)
    evaluation.write_table(scores, baselines, windows, paper, record, table, out)
