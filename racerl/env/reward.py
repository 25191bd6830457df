"""The reward: progress along the centreline in metres, or −1 where the episode ends."""

from torch import Tensor

END = -1.0


def progress_reward(progress: Tensor, ended: Tensor) -> Tensor:
    """Return (N,): s_t − s_{t−1}; −1 where the episode ended for good."""
    return progress.masked_fill(ended, END)
