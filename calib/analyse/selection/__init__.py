"""Which observations to keep: criteria, greedy, exchange, relaxation with a proven bound, exact search, floors."""
