"""Networks of robots: one protocol; behind it zenoh, under the names of rmw_zenoh, or DDS."""

from localiser.live.transports.link import ENDPOINT
from localiser.live.transports.opening import endpoints_of, open_transport, prefix_of
from localiser.live.transports.rmw_names import RmwNames
from localiser.live.transports.transport import (
    HearsAll,
    Reply,
    ReportsProblems,
    ServesRequests,
    Service,
    Take,
    Topic,
    Transport,
)
from localiser.live.transports.zenoh_transport import ZenohTransport
