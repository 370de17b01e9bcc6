"""Registry of the networks that can be trained: how each is built, and its loss."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from lf_flame.systems.aperturenet import ROUND, ApertureNet, build_aperturenet
from lf_flame.systems.base import NetworkSystem
from lf_flame.systems.refnet import RefNet, build_refnet, refnet_loss
from lf_flame.systems.refocusnet import RefocusNet, build_refocusnet
from lf_flame.systems.sparse_unet import SparseUNet, build_unet, unet_loss


@dataclass(frozen=True)
class Network:
    """A kind of network.

    Attributes
    ----------
    system : type of NetworkSystem
        Class of the system.
    model : callable
        Function of a seed that builds the Keras model.
    loss : str or callable
        Loss of the training.
    truth : str
        Reference image that it learns: a key of `lf_flame.systems.formulas.REFERENCES`.
    note : str
        Words that distinguish it from others of its kind.
    """

    system: type[NetworkSystem]
    model: Callable
    loss: str | Callable
    truth: str = "shift-and-sum"
    note: str = ""

    @property
    def title(self) -> str:
        """Name in tables."""
        return f"{self.system.name}, {self.note}" if self.note else self.system.name

    def build(self, seed: int) -> NetworkSystem:
        """Build the system, untrained."""
        return self.system(self.model(seed), self.title)


NETWORKS = {
    "aperturenet": Network(ApertureNet, build_aperturenet, "mean_squared_error"),
    "aperturenet-low-light": Network(
        ApertureNet, build_aperturenet, "mean_squared_error", note="trained in low light"
    ),
    "aperturenet-round": Network(
        ApertureNet,
        partial(build_aperturenet, view_weights=ROUND),
        "mean_squared_error",
        "round aperture",
        "trained on the round aperture",
    ),
    "refocusnet": Network(RefocusNet, build_refocusnet, "mean_squared_error"),
    "refnet": Network(RefNet, build_refnet, refnet_loss),
    "refnet-fourier": Network(
        RefNet, build_refnet, refnet_loss, "Fourier slice", "trained on the Fourier slice"
    ),
    "volumetric": Network(SparseUNet, build_unet, unet_loss),
}
