"""Tests that are written by hand, with `nw_run` and `nw_gate`."""

import pytest

from nw_eval import api


def test_a_gate_is_asked_in_a_line_and_the_assertion_says_what_it_found(
    suite, run, pytester, folders
):
    suite(trials=4)
    pytester.makepyfile("""
        def test_policy(nw_gate):
            assert nw_gate("tiny.yaml").passed

        def test_again(nw_gate, nw_run):
            assert nw_gate("tiny.yaml").report is nw_run("tiny.yaml")
            assert nw_run("tiny.yaml").verdict.verdict == "REGRESSED"
    """)
    done = run("-v")
    done.assert_outcomes(passed=1, failed=1)
    done.stdout.fnmatch_lines(
        [
            "E * assert False",
            "E *where False = REGRESSED * success 0.000 *.passed",
            "*Captured stdout call*",
            "REGRESSED * success 0.000 *",
            "nw-eval replay reports/tiny-*",
        ]
    )
    assert len(folders()) == 1, "one run serves both tests, and both fixtures"


def test_a_run_takes_fields_of_a_request_and_options_for_what_is_not_said(
    suite, run, pytester, folders, other
):
    suite(gate="")
    pytester.makepyfile("""
        def test_rounds(nw_run):
            judged = nw_run("tiny.yaml", trials=2)
            assert (len(judged.rows), judged.info.policy.name) == (2, "other")
            assert judged.passed
            assert repr(judged).startswith("RunReport(RAN, 'reports/tiny-")
            assert len(nw_run("tiny.yaml", policy="stand").rows) == 1
    """)
    run("--nw-policy", other).assert_outcomes(passed=1)
    assert {api.report(folder).info.policy.name for folder in folders()} == {"stand", "other"}


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        ("nw_gate('none.yaml')", "no suite 'none.yaml'*"),
        ("nw_run('tiny.yaml', policy='parkur')", "unknown policy 'parkur'*"),
        ("nw_run('tiny.yaml', trials='many')", "--trials 'many'*"),
        ("nw_gate('tiny.yaml')", "RAN *"),
    ],
)
def test_what_has_no_verdict_fails_the_test_in_words(suite, run, pytester, call, sentence):
    suite(gate="")
    pytester.makepyfile(f"""
        def test_policy(nw_run, nw_gate):
            {call}
    """)
    done = run()
    done.assert_outcomes(failed=1)
    done.stdout.fnmatch_lines(["*_ test_policy _*", sentence])
    assert "Traceback" not in done.stdout.str()
    assert "During handling" not in done.stdout.str()
    assert "nw_eval/" not in done.stdout.str()


@pytest.mark.parametrize(
    ("word", "outcome"),
    [
        pytest.param("fail", {"failed": 1}, marks=pytest.mark.nightly),
        pytest.param("xfail", {"xfailed": 1}, marks=pytest.mark.nightly),
        ("pass", {"passed": 1}),
    ],
)
def test_an_inconclusive_gate_is_what_the_ini_file_says(suite, run, pytester, word, outcome):
    suite()
    pytester.makepyfile("""
        def test_policy(nw_gate):
            assert nw_gate("tiny.yaml").passed
    """)
    run("-o", f"nw_inconclusive={word}").assert_outcomes(**outcome)


def test_a_run_without_results_is_an_error_where_a_fixture_of_the_tests_asks_for_it(
    suite, run, pytester
):
    suite(gate="")
    pytester.makepyfile("""
        import pytest

        @pytest.fixture(scope="module")
        def gated(nw_gate):
            return nw_gate("tiny.yaml", policy="nobody")

        def test_policy(gated):
            assert gated.passed
    """)
    run().assert_outcomes(errors=1)
