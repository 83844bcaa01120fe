!> How the search for a periodic solution ended. An outcome belongs to the
!! result; only wrong input is an error.
module viscovib_outcomes
  implicit none
  private

  !> The solution meets the tolerance.
  integer, parameter, public :: outcome_converged = 0
  !> Iteration limit reached, with corrections neither small nor growing.
  integer, parameter, public :: outcome_stalled = 1
  !> Corrections grow: the iteration does not converge here.
  integer, parameter, public :: outcome_diverged = 2
  !> The dynamic stiffness is singular: undamped resonance.
  integer, parameter, public :: outcome_singular = 3

  !> Parameters so extreme that the numbers overflow.
  integer, parameter, public :: outcome_overflow = 4

  !> Not computed: time limit reached.
  integer, parameter, public :: outcome_stopped = 5

  character(len=*), parameter, public :: outcome_names(0:5) = &
    [character(len=9) :: 'converged', 'stalled', 'diverged', 'singular', 'overflow', 'stopped']

end module viscovib_outcomes
