"""A window that nobody sees."""

import pygame
import pytest


@pytest.fixture(autouse=True)
def unseen(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


@pytest.fixture
def window(unseen):
    pygame.display.init()
    pygame.display.set_mode((64, 64))
    yield
    pygame.quit()
