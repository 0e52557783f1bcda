"""How accurate every estimator is, how honest its intervals are, and when it refuses: `make accuracy`.

A case is a plant, its sensors and what the estimator is told of them. A cell simulates some seeds of a case, hands
their CAN frames to every estimator and writes the answers down as one line of a file. Truth meets the answers in
`summary`, which reads those lines.
"""
