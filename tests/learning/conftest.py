"""A small network in a file."""

import keras
import pytest


@pytest.fixture(scope="session")
def network(tmp_path_factory):
    path = tmp_path_factory.mktemp("network") / "network.keras"
    seen = keras.Input((8, 8, 1))
    keras.Model(seen, keras.layers.Conv2D(2, 3, padding="same")(seen)).save(path)
    return path
