"""The wire between one learner and its actors.

What crosses it: rollouts (acked uploads, `upload`), policies (`weights`), who is there (`liveness`) and what
to do (`control`). Those modules speak to a `bus.Bus`; `session` is the bus over zenoh, `memory` the same bus
inside one process. Byte layouts are in `codec`, key expressions in `keys`.
"""
