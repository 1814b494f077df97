"""An adversary for the rules of the ESC: ESCs, cars, faults and people of its own, judged by these models alone.

``python3 test/adversary 1000`` runs random sequences, ``--sweep`` each fault at every 10 ms of a stop, ``--one SEED``
tells one sequence, ``--stops FILE`` compares distances of stops. It is written from docs/throttle.md, and shares
nothing with the product's simulator: of the product it imports the throttle and the servo board's channels alone.
"""
