"""What can go wrong between here and the Hub, each told in one sentence."""

import contextlib
from collections.abc import Iterator

from nerf_rl.errors import UserError
from nerf_rl.hub.address import Address
from nerf_rl.machine.extras import import_extra

_LOG_IN = "log in with 'hf auth login', or set HF_TOKEN"


@contextlib.contextmanager
def told_plainly(address: Address, deed: str) -> Iterator[None]:
    """Turn what huggingface_hub raises into a UserError; one says that the package is missing.

    Args:
        address: what is asked for.
        deed: what is done with it, such as ``fetched``.
    """
    import_extra("huggingface_hub", "hub", str(address))
    from huggingface_hub.errors import EntryNotFoundError, HTTPError

    try:
        yield
    except (HTTPError, EntryNotFoundError, OSError, ValueError) as error:
        raise UserError(f"{address} cannot be {deed}: {_reason(error, address)}") from error


def _reason(error: Exception, address: Address) -> str:
    from huggingface_hub import constants, errors

    server = constants.ENDPOINT
    if isinstance(error, errors.LocalEntryNotFoundError) and isinstance(error.__cause__, errors.HfHubHTTPError):
        error = error.__cause__  # the server said no, and then there was nothing in the cache either
    if isinstance(error, errors.GatedRepoError):
        return f"its owner has to let you in: ask at {server}/{address.repository}, and {_LOG_IN}"
    if isinstance(error, errors.RepositoryNotFoundError):
        return f"{server} has no such repository, or none that your token lets you see or make; {_LOG_IN}"
    if isinstance(error, errors.RevisionNotFoundError):
        return f"the repository has no revision {address.revision or 'main'}"
    if isinstance(error, errors.HfHubHTTPError):
        status = error.response.status_code
        said = f"{status}: {error.server_message or error}"
        if status in (401, 403):
            return f"{server} does not permit it ({said}); {_LOG_IN}, with a token that may do it"
        return f"{server} answers {said}"
    if isinstance(error, (errors.LocalEntryNotFoundError, errors.OfflineModeIsEnabled, errors.HTTPError)):
        told = type(error.__cause__ or error).__name__
        return f"{server} cannot be reached ({told}), and it is not here from before; is there a network?"
    return str(error)
