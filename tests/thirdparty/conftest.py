"""Plugins installed once for all tests in this folder.

The fixtures are agglo-hilbert, agglo-borders, all fakes, and thirty plain plugins.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from thirdparty.fakes import FAKES, plain_fakes
from thirdparty.installing import install, unpack

collect_ignore_glob = [
    "agglo-hilbert/*",
    "agglo-borders/*",
]  # their own tests run in their installation


@pytest.fixture(scope="session")
def hilbert(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Site folder with agglo-hilbert, built from its source tree."""
    site = tmp_path_factory.mktemp("hilbert")
    install(site, Path(__file__).parent / "agglo-hilbert")
    return site


@pytest.fixture(scope="session")
def borders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Site folder with agglo-borders, built from its source tree."""
    site = tmp_path_factory.mktemp("borders")
    install(site, Path(__file__).parent / "agglo-borders")
    return site


@pytest.fixture(scope="session")
def zoo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Site folder with all fakes."""
    site = tmp_path_factory.mktemp("zoo")
    wheels = tmp_path_factory.mktemp("wheels")
    install(site, *(fake.wheel(wheels) for fake in FAKES))
    return site


@pytest.fixture(scope="session")
def thirty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Site folder with thirty working plugins."""
    site = tmp_path_factory.mktemp("thirty")
    wheels = tmp_path_factory.mktemp("wheels")
    unpack(site, *(each.wheel(wheels) for each in plain_fakes(30)))
    return site
