!> Counters of the work actually done, for tests of what a plan skips.
!!
!! Work is counted by lines `if (counting) call count_up(counted_..., n)`. In the release build
!! `counting` is a false constant, and the compiler removes these lines. Concurrent threads may lose
!! counts, but a nonzero count never becomes 0.
module viscovib_counters
  use viscovib_counting, only: counting
  use viscovib_kinds, only: i8
  implicit none
  private

  public :: counting, count_up, count_unknowns, counted, reset_counters

  !> Kinds of work: kernel transforms (kernels times frequencies); samples of nonlinear deflections,
  !! their sines, monomials and forces; accelerations in vector lanes; iterations.
  integer, parameter, public :: counted_transforms = 1, counted_deflections = 2, &
                                counted_sines = 3, counted_monomials = 4, counted_forces = 5, &
                                counted_accelerations = 6, counted_turns = 7
  !> Unknowns, counted per coordinate and order: total; even orders; coordinates that are neither
  !! loaded nor coupled.
  integer, parameter, public :: counted_unknowns = 8, counted_even = 9, counted_idle = 10
  !> Terms of loads and of base motion converted to forces; steps in memory sums, and panels of a
  !! start; stored states; runs.
  integer, parameter, public :: counted_loads = 11, counted_base = 12, counted_memory = 13, &
                                counted_panels = 14, counted_states = 15, counted_runs = 16
  !> Fourier transforms; coordinates in tables; stored corrections; coordinates integrated in time
  !! (per block of vector lanes).
  integer, parameter, public :: counted_fourier = 17, counted_columns = 18, &
                                counted_corrections = 19, counted_coordinates = 20
  character(len=*), parameter, public :: counter_names(20) = &
    [character(len=22) :: 'kernel transforms', 'deflections', 'sines', 'monomials', 'forces', &
     'accelerations', 'iterations', 'unknowns', 'unknowns, even', 'unknowns, idle', 'load terms', &
     'base terms', 'steps remembered', 'panels of a start', 'states stored', 'runs', &
     'Fourier transforms', 'coordinates in tables', 'corrections stored', 'coordinates integrated']

  integer(i8) :: counts(size(counter_names)) = 0

contains

  subroutine count_up(kind, n)
    !> One of `counted_*`.
    integer, intent(in) :: kind
    integer, intent(in) :: n
    counts(kind) = counts(kind) + n
  end subroutine count_up

  !> Count the unknowns of given orders and coordinates at n frequencies.
  subroutine count_unknowns(orders, n_dof, n)
    integer, intent(in) :: orders(:), n_dof, n
    call count_up(counted_unknowns, size(orders)*n_dof*n)
    call count_up(counted_even, count(mod(orders, 2) == 0)*n_dof*n)
  end subroutine count_unknowns

  !> Count since `reset_counters`; 0 if this build does not count.
  integer(i8) function counted(kind)
    integer, intent(in) :: kind
    counted = counts(kind)
  end function counted

  subroutine reset_counters()
    counts = 0
  end subroutine reset_counters

end module viscovib_counters
