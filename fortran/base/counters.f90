!> How often each kind of work was really done, for tests of what a plan skips.
!!
!! Work is counted by lines `if (counting) call count_up(counted_..., n)`. In the
!! build as shipped `counting` is a constant that is false, and the compiler leaves
!! nothing of them. Threads that count at once may lose counts, but what any of them
!! counted never comes out as zero.
module viscovib_counters
  use viscovib_counting, only: counting
  use viscovib_kinds, only: i8
  implicit none
  private

  public :: counting, count_up, count_unknowns, counted, reset_counters

  !> Kinds of work: kernel transforms (kernels times frequencies); samples at which
  !! nonlinear deflections, their sines, their monomials and forces are evaluated;
  !! accelerations along the lanes; turns of an iteration.
  integer, parameter, public :: counted_transforms = 1, counted_deflections = 2, &
                                counted_sines = 3, counted_monomials = 4, counted_forces = 5, &
                                counted_accelerations = 6, counted_turns = 7
  !> Unknowns, a coordinate and an order each: in all; of even orders; of coordinates that
  !! are neither loaded nor coupled.
  integer, parameter, public :: counted_unknowns = 8, counted_even = 9, counted_idle = 10
  !> Terms of loads and of the base's motion made into forces; steps remembered, and
  !! panels of a start; states stored; runs made.
  integer, parameter, public :: counted_loads = 11, counted_base = 12, counted_memory = 13, &
                                counted_panels = 14, counted_states = 15, counted_runs = 16
  !> Fourier transforms; coordinates in tables; corrections stored; coordinates
  !! integrated in time (a block of lanes each).
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

  !> Unknowns of some orders and coordinates at n frequencies.
  subroutine count_unknowns(orders, n_dof, n)
    integer, intent(in) :: orders(:), n_dof, n
    call count_up(counted_unknowns, size(orders)*n_dof*n)
    call count_up(counted_even, count(mod(orders, 2) == 0)*n_dof*n)
  end subroutine count_unknowns

  !> Work counted since `reset_counters`; 0 if nothing is counted in this build.
  integer(i8) function counted(kind)
    integer, intent(in) :: kind
    counted = counts(kind)
  end function counted

  subroutine reset_counters()
    counts = 0
  end subroutine reset_counters

end module viscovib_counters
