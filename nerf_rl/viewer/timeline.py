"""Episodes and their frames, found in a dataset of any size by reading a few numbers."""

from bisect import bisect_left
from collections.abc import Sequence

from nerf_rl.datasets.storage.reader import MultiViewDataset


class _EpisodeColumn(Sequence):
    """The episode of each frame, each read from disk when it is asked for."""

    def __init__(self, dataset: MultiViewDataset):
        self._dataset = dataset

    def __len__(self) -> int:
        return len(self._dataset)

    def __getitem__(self, frame):  # type: ignore[no-untyped-def]
        return int(self._dataset.read("episode", [frame])[0])


class Timeline:
    """Where episodes begin and end.

    Episodes lie in order in a dataset, so one is found by bisection: opening a dataset of a thousand shards touches
    two of them, and finding an episode about ten.

    Args:
        dataset: to find episodes in.
    """

    def __init__(self, dataset: MultiViewDataset):
        self._column = _EpisodeColumn(dataset)
        self.frame_count = len(dataset)
        self.first, self.last = self._column[0], self._column[len(dataset) - 1]

    def frames(self, episode: int) -> range:
        """Return the frames of an episode; of the next one that has frames, if it has none.

        Raises:
            IndexError: it is outside ``first`` to ``last``.
        """
        if not self.first <= episode <= self.last:
            raise IndexError(f"episodes are {self.first} to {self.last}, got {episode}")
        begin = bisect_left(self._column, episode)
        return range(begin, bisect_left(self._column, self._column[begin] + 1, begin))

    def episode(self, frame: int) -> int:
        """Return the episode of a frame."""
        return self._column[frame]
