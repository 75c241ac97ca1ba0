import pytest
from studies import GOOD

from masat.study import Case, StudyError, load_design, parse_run


def test_the_papers_design_has_1200_instances_and_4800_runs():
    design = load_design("paper")
    noisy = [c for c in design.cases() if c.sigma]
    assert len(noisy) == len(set(noisy)) == 1200
    assert sum(len(design.columns_of(c)) for c in noisy) == 4800
    assert len(design.graphs) == 36


def test_the_quick_design_is_shipped():
    assert load_design("quick").instances > 0


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("manhattan:100:150", "Atlantis", 1, "unknown world 'Atlantis'"),
        ("manhattan:100:150", "manhattan:x:9", 1, "unknown world"),
        ('"masat"', '"masat", "magic"', 5, "unknown initial guess 'magic'"),
        ('"masat"', '"masat", "masat"', 5, "named twice"),
        ("0.3", "-0.3", 3, "not negative, got -0.3"),
        ("0.3", "nan", 3, "not negative, got nan"),
        ("0.3", '"loud"', 3, "must be a number"),
        ("[0.2, 0.2, 0.3]", "[0.2, 0.2]", 3, "2 sigmas and fits worlds in 3D only"),
        ("[0.2, 0.2, 0.3]", "[0.2]", 3, "a noise level is [x, y, theta] in 2D"),
        ("[0.2, 0.2, 0.3]", "[.1, .1, .1]", 3, "not a TOML file: Invalid value"),
        ("[0.2, 0.2, 0.3]", "[0.1, 0.1, 0.1]", 3, "given twice"),
        ("0.2, 0.3]", "\n 0.2,\n inf]", 5, "not negative, got inf"),
        ("0.3", "1e300", 3, "from 1e-09 to 1e+06"),
        ("0.3", "1e-300", 3, "from 1e-09 to 1e+06"),
        ("0.3", "0.30000001", 3, "at most six digits, since it names the runs: write 0.3 for"),
        ("0.3", "1" * 5000, 3, "too many digits"),
        ("0.3", "0x" + "f" * 5000, 3, "an integer of thousands of digits"),
        ("0.3", "[" * 10000, None, "nested too deeply"),
        ("manhattan:100:150", "sphere:100:150", 1, "is in 3D and no noise level has 2 or 6"),
        ("manhattan:100:150", f"manhattan:{10**12}:{10**13}", 1, "more than 10,000,000 nodes"),
        ("manhattan:100:150", "manhattan:100:99", 1, "no loop closure"),
        ("manhattan:100:150", "manhattan:100:0150", 1, "unknown world"),
        ("instances = 2", f"instances = {10**12}", 4, "at most 1,000,000, got 1000000000000"),
        ("instances = 2", "instances = 900_000", 4, "1,800,000 runs; at most 1,000,000"),
        ("instances = 2", "instances = 2\ninstances = 3", 5, "a key is given twice"),
        ("instances = 2", "instances = 2\nmax_iterations = 1_000_000", 5, "at most 10,000"),
        ("instances = 2", 'instances = 2\ngraphs = [\n"MIT",\n"MITT"]', 7, "dataset 'MITT'"),
        ("instances = 2", "instances = 2\ntitle = 7", 5, "title must be a line"),
        ("instances = 2", "instances = 2\n[inner]\nkey = 1", 5, "unknown key 'inner'"),
        ("inits = ", "starts = ", 5, "'starts' is now called 'inits'"),
        ("worlds = ", "# worlds = [1]\n worlds = 5 # ", 2, "must be a list of names"),
        ('["masat"]', '[\n# "masat"\n"odometry", "masat",\n "masat"]', 8, "named twice"),
        ("instances = 2", "instances = 0", 4, "positive integer"),
        ("instances = 2", "instances = 1.5", 4, "positive integer"),
        ("instances = 2", "repeats = 2", 4, "unknown key 'repeats'"),
        ("instances = 2", "", None, "instances must be"),
        ("worlds = ", "worlds = [[[", 2, "not a TOML file: Unclosed array"),
    ],
)
def test_a_bad_design_is_refused_with_the_line(old, new, line, said, tmp_path):
    path = tmp_path / "design.toml"
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(StudyError) as error:
        load_design(str(path))
    assert said in str(error.value)
    if line is not None:
        assert f"design.toml:{line}: " in str(error.value)


def test_an_unknown_design_names_those_that_are_shipped():
    with pytest.raises(StudyError, match="come with masat: false_closures, inits, paper, quick"):
        load_design("grand")


UTF16 = GOOD.encode("utf-16")


@pytest.mark.parametrize(
    ("data", "line", "said"),
    [
        (UTF16, 1, "save the design as a text file in UTF-8"),
        (GOOD.encode("utf-16-le"), 1, "not UTF-8 text"),
        (GOOD.encode() + b"# caf\xe9", 6, "not UTF-8 text"),
        (b"\0" * 100, 1, "not UTF-8 text"),
        (GOOD.encode() + b"#" * 1_000_000, None, "more than 1,000,000 bytes"),
        (b"", None, "worlds is missing or empty"),
    ],
)
def test_a_file_that_is_no_text_in_utf8_is_refused_in_one_line(data, line, said, tmp_path):
    path = tmp_path / "design.toml"
    path.write_bytes(data)
    with pytest.raises(StudyError) as error:
        load_design(str(path))
    assert said in str(error.value)
    assert "\n" not in str(error.value)
    assert str(error.value).startswith(f"{path}:" + (f"{line}: " if line else " "))


def test_windows_line_ends_and_a_byte_order_mark_do_no_harm(tmp_path):
    path = tmp_path / "design.toml"
    path.write_text(GOOD)
    design = load_design(str(path))
    path.write_bytes(b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())
    assert load_design(str(path)) == design


def test_a_folder_is_no_design(tmp_path):
    with pytest.raises(StudyError, match="is a folder"):
        load_design(str(tmp_path))


def test_the_title_is_the_files_name_unless_given(tmp_path):
    path = tmp_path / "my study.toml"
    path.write_text(GOOD)
    assert load_design(str(path)).title == "my study"
    path.write_text('title = "Walks"\n' + GOOD)
    assert load_design(str(path)).title == "Walks"
    assert load_design("paper").title == "The evaluation of MASAT"


MIXED = """\
worlds = ["manhattan:100:150", "sphere:60:100", "garage"]
sigmas = [[0.1, 0.1, 0.1], [0.1, 0.05], [0.1, 0.1, 0.2, 0.01, 0.01, 0.02]]
instances = 2
inits = ["masat", "ground_truth"]
graphs = ["tinyGrid3D", "MIT"]
"""


def test_each_world_takes_the_levels_of_its_dimension(tmp_path):
    path = tmp_path / "mixed.toml"
    path.write_text(MIXED)
    design = load_design(str(path))
    plane, two, six = design.sigmas
    cells = {(c.world, c.sigma) for c in design.cases()}
    assert cells == {
        ("manhattan:100:150", plane),
        ("sphere:60:100", two),
        ("sphere:60:100", six),
        ("garage", two),
        ("garage", six),
        ("tinyGrid3D", ()),
        ("MIT", ()),
    }
    assert design.runs() == 2 * 5 * 2 + 2 == sum(len(design.columns_of(c)) for c in design.cases())


def test_the_truth_alone_of_real_graphs_alone_is_nothing_to_run(tmp_path):
    path = tmp_path / "design.toml"
    path.write_text('graphs = ["MIT"]\n\ninits = ["ground_truth"]\n')
    with pytest.raises(StudyError, match=r"design\.toml:3: real graphs have no ground truth"):
        load_design(str(path))


@pytest.mark.parametrize(
    "name", ["sphere:60:100/.1,.05/0", "sphere/.1,.1,.1,1e-05,0,1/3", "MIT//0"]
)
def test_names_of_cases_in_3d_and_of_real_graphs_lead_back_to_them(name):
    case, init = parse_run(f"{name}/masat")
    assert init == "masat"
    assert case.name == name


def test_the_name_of_a_run_leads_back_to_it():
    case = Case("City10k", (0.35, 0.35, 0.35), 17)
    assert case.name == "City10k/.35,.35,.35/17"
    assert parse_run(case.name + "/masat") == (case, "masat")
    for name in ("City10k", "City10k/x,y,z/17/masat", "City10k/.1,.1,.1/one/masat"):
        with pytest.raises(StudyError, match="names no run"):
            parse_run(name)


def test_each_case_has_a_seed_of_its_own_that_never_changes():
    seeds = {c.seed for c in load_design("paper").cases()}
    assert len(seeds) == 1236
    assert Case("City10k", (0.35, 0.35, 0.35), 17).seed == 13394451965791113973
