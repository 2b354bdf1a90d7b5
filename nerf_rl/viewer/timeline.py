"""Episodes and their frames, found in a dataset of any size by reading a few numbers."""

from bisect import bisect_left

from nerf_rl.datasets.storage.reader import MultiViewDataset


class Timeline:
    """Where episodes begin and end.

    Episodes lie in order in a dataset, so one is found by bisection: opening a dataset of a thousand shards touches
    two of them, and finding an episode about ten.

    Args:
        dataset: to find episodes in.
    """

    def __init__(self, dataset: MultiViewDataset):
        self._dataset = dataset
        self.frame_count = len(dataset)
        self.first, self.last = self.episode(0), self.episode(len(dataset) - 1)

    def frames(self, episode: int) -> range:
        """Return the frames of an episode; of the next one that has frames, if it has none.

        Raises:
            IndexError: it is outside ``first`` to ``last``.
        """
        if not self.first <= episode <= self.last:
            raise IndexError(f"episodes are {self.first} to {self.last}, got {episode}")
        frames = range(self.frame_count)
        begin = bisect_left(frames, episode, key=self.episode)
        return range(begin, bisect_left(frames, self.episode(begin) + 1, begin, key=self.episode))

    def episode(self, frame: int) -> int:
        """Return the episode of a frame."""
        return int(self._dataset.read("episode", [frame])[0])
