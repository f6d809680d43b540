"""agglo's laws for the components of this distribution."""

from agglo_core.conformance import conformance

test_hilbert = conformance("bisector:hilbert")
test_leaves = conformance("refiner:leaves")
test_gyration = conformance("metric:gyration")
