"""Routes that use an edge more than once: how far an ego has really come on them."""

import libsumo


class Passages:
    """How far egos have come on routes that pass an edge several times.

    SUMO maps a pose to the nearest lane of the whole route. At a junction that the route crosses several times that may
    be a lane of a later time, and what is between is then left out.
    """

    def __init__(self) -> None:
        self._routes: dict[str, tuple[str, tuple[str, ...]]] = {}  # id and edges of those that pass an edge again
        self._at: dict[str, int] = {}

    def note(self, ego: str, lane: str) -> bool:
        """The ego is on a lane now; whether its route has been set anew, to what is left of it."""
        name = libsumo.vehicle.getRouteID(ego)
        known, edges = self._routes.get(ego, ("", ()))
        if name != known:
            route = tuple(libsumo.vehicle.getRoute(ego))
            edges = route if len(set(route)) < len(route) else ()
            self._routes[ego] = name, edges
            self._at[ego] = max(libsumo.vehicle.getRouteIndex(ego), 0)
        if not edges or lane.startswith(":"):
            return False
        edge, at = libsumo.lane.getEdgeID(lane), self._at[ego]
        if edge not in edges[at:]:
            return False
        self._at[ego] = edges.index(edge, at)
        if libsumo.vehicle.getRouteIndex(ego) == self._at[ego]:
            return False
        libsumo.vehicle.setRoute(ego, edges[self._at[ego] :])
        return True
