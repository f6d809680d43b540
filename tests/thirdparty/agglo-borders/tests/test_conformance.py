"""agglo's laws for the components of this distribution."""

from agglo_core.conformance import conformance

test_toy = conformance("format:toy")
test_cross = conformance("sample:cross")
test_heat = conformance("problem:heat")
test_cells_cg = conformance("solver:cells_cg")
test_two_sweeps = conformance("smoother:two_sweeps")
test_crowding = conformance("metric:crowding")
test_apart = conformance("constraint:apart")
test_sizes = conformance("section:sizes")
