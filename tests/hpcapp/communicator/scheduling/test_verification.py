"""Whose answers are believed, and what becomes of work that has used those of a liar."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import cycle

import pytest

from hpcapp.communicator.scheduling.state import Task
from hpcapp.communicator.scheduling.verification import (
    AnswerVerdict,
    Verification,
    attempt,
    digest_answer,
    repeat_until_trusted,
)
from hpccomponent.errors import ConfigError, DistrustError, NoWorkersError, TaskError
from hpccomponent.protocol.messages import Result

A = frozenset("a")


def judge(
    verification: Verification, task: Task, machine: str, told: bytes, names: str = "abc"
) -> tuple[AnswerVerdict, list[str]]:
    others = set(names) - {machine, *task.answers}
    return verification.judge(task, machine, others, lambda: told)


def test_two_equal_answers_are_believed() -> None:
    verification, task = Verification(1.0), Task(1, "t", 1)
    assert judge(verification, task, "a", b"x") == (AnswerVerdict.ASK_ANOTHER, [])
    assert judge(verification, task, "b", b"x") == (AnswerVerdict.BELIEVED, [])
    assert verification.verified == 1
    assert verification.answers == {frozenset("ab"): 1}


@pytest.mark.parametrize("liar", ["a", "b"])
def test_a_third_machine_decides_between_two_answers(liar: str) -> None:
    verification, task = Verification(1.0), Task(1, "t", 1)
    told = {"a": b"x", "b": b"x", "c": b"x", liar: b"y"}
    assert judge(verification, task, "a", told["a"]) == (AnswerVerdict.ASK_ANOTHER, [])
    assert judge(verification, task, "b", told["b"]) == (AnswerVerdict.ASK_ANOTHER, [])
    assert judge(verification, task, "c", told["c"]) == (AnswerVerdict.BELIEVED, [liar])
    assert verification.disagreements == 1


def test_of_four_machines_three_must_agree_on_a_disputed_answer() -> None:
    verification, task = Verification(1.0), Task(1, "t", 1)
    for machine, told in zip("abc", (b"y", b"x", b"x"), strict=True):
        assert judge(verification, task, machine, told, "abcd") == (AnswerVerdict.ASK_ANOTHER, [])
    assert verification.disagreements == 1
    assert judge(verification, task, "d", b"x", "abcd") == (AnswerVerdict.BELIEVED, ["a"])


def test_two_that_conspire_among_four_throw_nobody_out() -> None:
    verification, task = Verification(1.0), Task(1, "t", 1)
    for machine, told in zip("abc", (b"y", b"x", b"y"), strict=True):
        assert judge(verification, task, machine, told, "abcd") == (AnswerVerdict.ASK_ANOTHER, [])
    assert judge(verification, task, "d", b"x", "abcd") == (AnswerVerdict.UNDECIDED, [])


def test_where_the_fourth_is_lost_two_of_three_decide_whoever_answers_again() -> None:
    verification, task = Verification(1.0), Task(1, "t", 1)
    for machine, told in zip("abc", (b"y", b"x", b"x"), strict=True):
        judge(verification, task, machine, told, "abcd")
    assert judge(verification, task, "a", b"y", "abc") == (AnswerVerdict.ASK_ANOTHER, ["a"])
    assert judge(verification, task, "b", b"x", "abc") == (AnswerVerdict.BELIEVED, ["a"])


def test_what_two_liars_agreed_on_is_distrusted_once_both_are_found() -> None:
    verification, first, second = Verification(1.0), Task(1, "t", 1), Task(2, "t", 1)
    for machine in "ab":
        verdict, _ = judge(verification, first, machine, b"y", "abcde")
    assert verdict is AnswerVerdict.BELIEVED
    for machine, told in zip("acbde", (b"y", b"x", b"y", b"x", b"x"), strict=True):
        verdict, lying = judge(verification, second, machine, told, "abcde")
    assert (verdict, lying) == (AnswerVerdict.BELIEVED, ["a", "b"])
    verification.accuse("a", "it lied")
    assert not verification.distrust
    verification.accuse("b", "it lied")
    assert "1 of its answers" in verification.distrust


def test_who_fails_alone_is_one_of_the_three_that_decide() -> None:
    verification, task = Verification(1.0), Task(1, "t", 1, failed_on="c")
    assert judge(verification, task, "a", b"x", "ab") == (AnswerVerdict.ASK_ANOTHER, [])
    assert judge(verification, task, "b", b"y", "ab") == (AnswerVerdict.UNDECIDED, [])


def test_three_different_answers_decide_nothing() -> None:
    verification, task = Verification(1.0), Task(1, "t", 1)
    for machine, told in zip("ab", (b"x", b"y"), strict=True):
        assert judge(verification, task, machine, told)[0] is AnswerVerdict.ASK_ANOTHER
    assert judge(verification, task, "c", b"z") == (AnswerVerdict.UNDECIDED, [])


def test_a_machine_that_contradicts_itself_is_a_liar() -> None:
    verification, task = Verification(1.0), Task(1, "t", 1)
    judge(verification, task, "a", b"x")
    assert judge(verification, task, "a", b"y", "a") == (AnswerVerdict.ASK_ANOTHER, ["a"])


def test_where_nobody_else_is_left_the_same_answer_again_is_taken_and_counted() -> None:
    verification, task = Verification(1.0), Task(1, "t", 1)
    judge(verification, task, "a", b"x")
    assert judge(verification, task, "a", b"x", "a") == (AnswerVerdict.BELIEVED, [])
    assert (verification.verified, verification.unverified) == (0, 1)
    assert verification.answers[A] == 1


@pytest.mark.parametrize(("share", "names"), [(0.0, "abc"), (None, "abc"), (1.0, "ab")])
def test_no_answer_is_asked_for_again_without_a_share_or_a_third_machine(
    share: float | None, names: str
) -> None:
    verification = Verification(share)
    assert judge(verification, Task(1, "t", 1), "a", b"x", names) == (AnswerVerdict.BELIEVED, [])


def test_the_share_is_that_of_the_answers() -> None:
    numbers: Iterator[float] = cycle([0.05, 0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 0.95])
    verification = Verification(0.2, lambda: next(numbers))
    asked = [judge(verification, Task(n, "t", 1), "a", b"x")[0] for n in range(100)]
    assert asked.count(AnswerVerdict.ASK_ANOTHER) == 20


def test_what_a_task_has_written_is_part_of_its_answer() -> None:
    plain = Result(1, 0.1, b"h", [3])
    assert digest_answer(plain, [b"abc"]) == digest_answer(Result(9, 7.0, b"h", [3]), [b"abc"])
    assert digest_answer(plain, [b"abc"]) != digest_answer(plain, [b"abd"])
    written = Result(1, 0.1, b"h", [3], written=1)
    assert digest_answer(plain, [b"abc"]) != digest_answer(written, [b"abc"])


def test_work_that_has_used_a_liars_answer_begins_anew() -> None:
    verification, runs = Verification(0.5), []

    def run(is_first: bool) -> str:
        runs.append(is_first)
        verification.begin()
        with attempt(verification):
            verification.answers[A] += is_first
            verification.accuse("a", "it lied")
        return "true"

    assert repeat_until_trusted(verification, run) == "true"
    assert runs == [True, False]
    assert verification.liars == {"a": "it lied"}
    assert "1 of its answers had been used" in verification.repeats[0]


def test_what_a_task_finds_impossible_is_made_again_once_with_every_answer_verified() -> None:
    verification = Verification(0.02)
    shares = []

    def run(is_first: bool) -> None:
        del is_first
        verification.begin()
        shares.append(verification.everything)
        judge(verification, Task(1, "t", 1), "a", b"x")
        verification.answers[A] += 1
        with attempt(verification):
            raise TaskError("no such block")

    with pytest.raises(TaskError, match="no such block"):
        repeat_until_trusted(verification, run)
    assert shares == [False, True]
    verification.begin_job()
    assert not verification.everything


@pytest.mark.parametrize("error", [NoWorkersError("none"), OSError("full"), KeyboardInterrupt()])
def test_what_no_lie_can_cause_is_not_made_again(error: BaseException) -> None:
    verification = Verification(0.02)
    judge(verification, Task(1, "t", 1), "a", b"x")
    verification.answers[A] += 1
    with pytest.raises(type(error)) as raised, attempt(verification):
        raise error
    assert raised.value is error


def test_an_error_after_a_lie_came_out_is_laid_to_the_lie() -> None:
    verification = Verification()
    verification.answers[A] += 1
    verification.accuse("a", "it lied")
    with pytest.raises(DistrustError, match="it lied"), attempt(verification):
        raise IndexError(7)


def test_an_answer_that_is_about_the_machine_is_not_asked_for_again() -> None:
    task = Task(1, "t", 1, is_verified=False)
    assert judge(Verification(1.0), task, "a", b"x") == (AnswerVerdict.BELIEVED, [])


def test_what_a_liar_has_written_for_a_pending_answer_is_distrusted() -> None:
    verification = Verification(1.0)
    plain, written = Task(1, "t", 1), Task(2, "t", 1, has_written=True)
    judge(verification, plain, "a", b"x")
    verification.accuse("a", "it lied", [plain])
    assert not verification.distrust
    assert not plain.answers
    judge(verification, written, "a", b"x")
    verification.accuse("a", "it lied", [written])
    assert verification.distrust


def test_what_the_caller_raises_is_no_lie() -> None:
    verification = Verification(0.5)
    judge(verification, Task(1, "t", 1), "a", b"x")
    verification.answers[A] += 1
    own = RuntimeError("enough")
    with pytest.raises(RuntimeError, match="enough"), attempt(verification, lambda e: e is own):
        raise own


def test_an_error_before_the_next_attempt_has_begun_ends_the_job() -> None:
    verification = Verification(0.5)

    def run(is_first: bool) -> None:
        with attempt(verification):
            if not is_first:
                raise ConfigError("the inventory is gone")
            verification.answers[A] += 1
            verification.accuse("a", "it lied")

    with pytest.raises(ConfigError, match="gone"):
        repeat_until_trusted(verification, run)
