"""From a folder on this machine to one commit on the Hub."""

import sys
from pathlib import Path

from nerf_rl import __version__
from nerf_rl.errors import UserError
from nerf_rl.hub.address import Address
from nerf_rl.hub.failures import told_plainly
from nerf_rl.hub.fetch import FILES


def commit_folder(folder: Path, address: Address, private: bool, message: str, unlike: str) -> Address:
    """Put a folder's files into a repository, which is made if there is none; return the address with the commit.

    It is one commit, so that whoever fetches meanwhile has all of the new files or none. Files of an artefact that the
    folder has not got any more are removed with it.

    Args:
        folder: all of it is committed.
        address: of the repository, and of the branch if it is not the main one; it is made if there is none.
        private: whether a repository that is made is visible to its owner alone.
        message: of the commit.
        unlike: a file that marks a repository of another kind of artefact, which is left alone.

    Raises:
        UserError: no permission, no network, another kind of artefact there, or the extra ``hub`` is not installed.
    """
    names = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    repository, branch = address.repository, address.revision or None
    with told_plainly(address, "pushed to"):
        import huggingface_hub
        from huggingface_hub import CommitOperationAdd, CommitOperationCopy, CommitOperationDelete
        from huggingface_hub.utils import disable_progress_bars

        if not sys.stderr.isatty():
            disable_progress_bars()

        hub = huggingface_hub.HfApi(library_name="nerf-rl", library_version=__version__)
        hub.create_repo(repository, private=private or None, exist_ok=True)
        if branch:
            hub.create_branch(repository, branch=branch, exist_ok=True)
        there = hub.list_repo_files(repository, revision=branch)
        if unlike in there:
            raise UserError(f"{address} holds another kind of artefact ({unlike}); push to another repository")
        stale = [name for name in there if name in FILES and name not in names]
        operations: list[CommitOperationAdd | CommitOperationCopy | CommitOperationDelete] = [
            *(CommitOperationAdd(path_in_repo=name, path_or_fileobj=folder / name) for name in names),
            *(CommitOperationDelete(path_in_repo=name) for name in stale),
        ]
        done = hub.create_commit(repository, operations, commit_message=message, revision=branch)
    return Address(repository, done.oid)
