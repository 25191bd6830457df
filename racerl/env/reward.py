"""The reward: progress along the centreline in metres, or −1 where the car leaves the track."""

import torch
from torch import Tensor

OFF_TRACK = -1.0


def progress_reward(progress: Tensor, ended: Tensor) -> Tensor:
    """Return (N,): s_t − s_{t−1}; −1 where the episode ended off track."""
    return torch.where(ended, OFF_TRACK, progress)
