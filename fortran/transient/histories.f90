!> Storage of the past of a run: as exponentials, or step by step.
module viscovib_histories
  use viscovib_collocation, only: collocation_type
  use viscovib_direct_history, only: direct_history_type, new_direct_history
  use viscovib_exponential_history, only: exponential_history_type, new_exponential_history
  use viscovib_history, only: history_type
  use viscovib_kinds, only: wp
  use viscovib_memory_channels, only: channels_type, is_steep
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: error_of_sums, keeping_type, new_history, past_request

  integer, parameter, public :: past_exponentials = 1, past_direct = 2

  !> Doublings from the first panel after a corner or a jump of the load to a step:
  !! accelerations after it follow t^(2+alpha), so that fewer are needed than at a
  !! start, see `viscovib_hereditary_start`; after a corner of the base, which is a jump
  !! of the relative velocity, they follow t^(1+alpha). Largest number, for a piece after a much
  !! shorter one.
  integer, parameter :: corner_doublings = 14, kink_doublings = 21, most_doublings = 60

  !> Factor of the error of sums of exponentials for every other halving of the step: otherwise both
  !! runs may use the same lattice, and the difference of states would not show its error.
  real(wp), parameter :: sharper = 0.25_wp

  !> How a run stores its past, and the motion before it.
  type :: past_request
    !> Nodes of a step; `past_exponentials` or `past_direct`.
    integer :: nodes = 8, past = past_exponentials
    !> Step; latest time of any run that continues; relative error of the kernels as exponentials
    !! and of a step's solution.
    real(wp) :: h = 0.0_wp, t_end = 0.0_wp, tolerance = 0.0_wp
    !> Shortest step of a run whose steps change after corners of the load, 0: there are none; true
    !! if velocities may jump there.
    real(wp) :: shortest = 0.0_wp
    logical :: kinks = .false.
    !> Displacements held for all t < 0, shape (n_dof), or before the first of the times `before`.
    real(wp), allocatable :: held(:)
    !> Times ascending to 0 and displacements there, shapes (n) and (n_dof, n), if the motion
    !! before 0 is known.
    real(wp), allocatable :: before(:), moved(:, :)
  end type past_request

  !> Treatment of corners in a run.
  type :: keeping_type
    !> True if some kernel is so steep at the start that a motion with a corner needs panels
    !! after it.
    logical :: steep = .false.
    !> True if the next step follows a corner of the load; doublings of this step, and usual number.
    logical :: at_corner = .false.
    integer :: n_doublings = corner_doublings, doublings = corner_doublings
    !> Choice of panel ends: different in a run of half the step, so that the errors differ.
    logical :: between = .false.
  contains
    procedure :: turn
  end type keeping_type

contains

  !> Create storage for the past. `possible` is false if a kernel has no sum of exponentials.
  subroutine new_history(history, keeping, system, channels, table, request, possible)
    class(history_type), allocatable, intent(out) :: history
    type(keeping_type), intent(out) :: keeping
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    type(collocation_type), intent(in) :: table
    type(past_request), intent(in) :: request
    logical, intent(out) :: possible
    type(exponential_history_type), allocatable :: exponentials
    type(direct_history_type), allocatable :: direct
    real(wp) :: least

    possible = .true.
    associate (h => request%h)
      least = h
      keeping%between = modulo(exponent(h), 2) == 1
      if (request%shortest > 0.0_wp) then
        keeping%steep = is_steep(system, channels, h)
        least = min(h, request%shortest)
        if (request%kinks) keeping%doublings = kink_doublings
        if (keeping%steep) least = scale(least, -keeping%doublings - 1)
      end if
      if (request%past == past_exponentials) then
        allocate (exponentials)
        call new_exponential_history(exponentials, system, channels, table, h, least, &
                                     request%t_end, error_of_sums(request%tolerance, h), possible)
        call move_alloc(exponentials, history)
      else
        allocate (direct)
        call new_direct_history(direct, system, channels, table, h)
        call move_alloc(direct, history)
      end if
    end associate
  end subroutine new_history

  !> Relative error of the sums for steps h.
  elemental real(wp) function error_of_sums(tolerance, h) result(error)
    real(wp), intent(in) :: tolerance, h
    error = max(merge(sharper, 1.0_wp, modulo(exponent(h), 2) == 1)*tolerance, 1.0e-14_wp)
  end function error_of_sums

  !> Register a corner, with step `before` before it and step h after it.
  subroutine turn(self, before, h)
    class(keeping_type), intent(inout) :: self
    real(wp), intent(in) :: before, h
    self%at_corner = self%steep
    ! The motion after a short piece is as steep as the piece is short.
    self%n_doublings = min(max(self%doublings, exponent(h) - exponent(before)), most_doublings)
  end subroutine turn

end module viscovib_histories
