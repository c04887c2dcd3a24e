"""Continuous tasks as finite MDPs.

A cell is a state of the finite MDP. On a grid (``GridInterpolation``) it is a vertex,
and a step that ends between vertices is shared out among them; for more than three
features a cell is the neighbourhood of one of the states that the simulator visits
(``VisitedCells``). Every cell is stepped under every action, so its rows are the
simulator's own, averaged over the cell.

That costs accuracy: ``Discretization.diagnostics["closure_error"]`` is the share by
which the uniform policy's value on the cells differs from its value in the task, by
Monte Carlo. Halving the cells' width divides it by about four on a grid.

``build`` makes the MDP, ``cells`` has grids and neighbourhoods, ``model`` the result
with the way from states to cells and back.
"""
