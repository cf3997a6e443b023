class Routes:
    pass
