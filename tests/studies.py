"""A small study and what tests ask of it."""

from concurrent.futures import ThreadPoolExecutor

from masat.study import Case, Design, Trial, run_study

WORLD = "manhattan:150:230"
SMALL = Design(
    worlds=(WORLD,),
    sigmas=((0.1, 0.1, 0.1), (0.2, 0.2, 0.2)),
    instances=3,
    inits=("spanning_tree", "masat", "ground_truth"),
)
CASE = Case(WORLD, (0.1, 0.1, 0.1), 0)

GOOD = """\
worlds = ["manhattan:100:150"]
sigmas = [[0.1, 0.1, 0.1],
          [0.2, 0.2, 0.3]]
instances = 2
inits = ["masat"]
"""


def trial(chi2, case=CASE, init="masat"):
    return Trial(case, init, tuple(chi2), 10, 0.001, 0.01)


def keys(store):
    return sorted((t.case.name, t.column) for t in store.trials())


def wanted(design):
    return sorted((c.name, i) for c in design.cases() for i in design.columns_of(c))


def run_all(store, **more):
    with ThreadPoolExecutor(2) as executor:
        run_study(store, executor, **more)
