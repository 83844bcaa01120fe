! Optimize: -O1
!> The state of a structure in time: its modes, in whole blocks, and deflections of its elements.
module viscovib_structure_state
  use viscovib_kinds, only: wp
  use viscovib_modal_maps, only: sections_type
  use viscovib_pole_maps, only: pole_rates, seen_at_once, seen_of_poles
  use viscovib_structure_kernels, only: mode_block, seen_of
  implicit none
  private

  public :: padded_rows, padded_sections, rate_of, set_state, show_state, start_state, state_type

  real(wp), parameter :: trace = 1.0e-9_wp

  type :: state_type
    !> Modes, their velocities, and the rounding errors of both, shape (n).
    real(wp), allocatable :: q(:), v(:), q_rest(:), v_rest(:)
    !> The part without real modes.
    complex(wp), allocatable :: z(:), z_rest(:)
    !> Rates of the massless variables.
    real(wp), allocatable :: z_rate(:)
    !> Deflections of the elements and their rates, shape (n_seen).
    real(wp), allocatable :: w(:), w_rate(:)
    !> Largest last Legendre coefficient of the deflections on a step, and largest deflection.
    real(wp), allocatable :: roughness(:), largest(:)
    !> Largest sum of the sizes of all modes.
    real(wp) :: furthest = 0.0_wp
  contains
    procedure :: resolution
    procedure :: n_numbers
    procedure :: save_numbers
    procedure :: load_numbers
    procedure :: at_once_numbers
    procedure :: load_at_once
  end type state_type

contains

  !> Deflections and their rates of an initial state.
  pure subroutine start_state(state, sections)
    type(state_type), intent(inout) :: state
    type(sections_type), intent(in) :: sections
    integer :: j
    associate (n => size(state%q)/mode_block)
      do j = 1, size(sections%seen, 2)
        state%w(j) = seen_of(n, sections%seen(:, j), state%q) &
                     + seen_of_poles(sections%others%left(:, j), state%z)
        state%w_rate(j) = rate_of(state, sections, j)
      end do
    end associate
  end subroutine start_state

  !> Rate of a deflection.
  pure real(wp) function rate_of(state, sections, j)
    type(state_type), intent(in) :: state
    type(sections_type), intent(in) :: sections
    integer, intent(in) :: j
    rate_of = seen_of(size(state%q)/mode_block, sections%seen(:, j), state%v) &
              + pole_rates(sections%others%left(:, j), sections%others%poles, state%z) &
              + seen_at_once(sections%others%left(:, j), state%z_rate)
  end function rate_of

  !> Set an initial state: modes, then Re z and Im z of the part without real modes.
  pure subroutine set_state(state, sections, q, v)
    type(state_type), intent(inout) :: state
    type(sections_type), intent(in) :: sections
    real(wp), intent(in) :: q(:), v(:)
    integer :: m, n, n_poles, r

    n = size(sections%squares)
    n_poles = size(sections%others%poles)
    m = size(q) - n_poles
    r = size(sections%seen, 2)
    if (.not. allocated(state%q)) then
      allocate (state%q(n), state%v(n), state%q_rest(n), state%v_rest(n))
      allocate (state%z(n_poles), state%z_rest(n_poles), state%w(r), state%w_rate(r))
      allocate (state%z_rate(sections%others%n_at_once))
      allocate (state%roughness(r), state%largest(r), source=0.0_wp)
    end if
    state%q = 0.0_wp
    state%v = 0.0_wp
    state%q(:m) = q(:m)
    state%v(:m) = v(:m)
    state%z = cmplx(q(m + 1:), v(m + 1:), wp)
    state%q_rest = 0.0_wp
    state%v_rest = 0.0_wp
    state%z_rest = (0.0_wp, 0.0_wp)
    state%z_rate = 0.0_wp
    call start_state(state, sections)
  end subroutine set_state

  !> Coordinates and their velocities, from modes (q, v) and from the part without real modes.
  pure subroutine show_state(sections, shown, shown_left, q, v, z, z_rate, u, rates)
    type(sections_type), intent(in) :: sections
    !> By modes, shapes (n, n_shown) and (n_poles, n_shown).
    real(wp), intent(in) :: shown(:, :)
    complex(wp), intent(in) :: shown_left(:, :)
    real(wp), intent(in) :: q(:), v(:)
    complex(wp), intent(in) :: z(:)
    !> Rates of the massless variables.
    real(wp), intent(in) :: z_rate(:)
    real(wp), intent(out) :: u(:), rates(:)
    integer :: d
    do d = 1, size(u)
      u(d) = seen_of(size(q)/mode_block, shown(:, d), q) + seen_of_poles(shown_left(:, d), z)
      rates(d) = seen_of(size(q)/mode_block, shown(:, d), v) &
                 + pole_rates(shown_left(:, d), sections%others%poles, z) &
                 + seen_at_once(shown_left(:, d), z_rate)
    end do
  end subroutine show_state

  !> The largest last Legendre coefficient, relative to the largest deflection; or to a part of the
  !! deflection that the modes could cause, if a deflection is only the first trace of a wave.
  pure real(wp) function resolution(self, sections)
    class(state_type), intent(in) :: self
    type(sections_type), intent(in) :: sections
    real(wp) :: size_of
    integer :: j
    resolution = 0.0_wp
    do j = 1, size(self%largest)
      size_of = max(self%largest(j), trace*self%furthest*maxval(abs(sections%seen(:, j))))
      if (size_of > 0.0_wp) resolution = max(resolution, self%roughness(j)/size_of)
    end do
  end function resolution

  !> Length of a saved state without its massless variables, whose number
  !! depends on the load.
  pure integer function n_numbers(self)
    class(state_type), intent(in) :: self
    n_numbers = 1 + 4*(size(self%q) + size(self%z) - size(self%z_rate) + size(self%w))
  end function n_numbers

  pure function save_numbers(self) result(numbers)
    class(state_type), intent(in) :: self
    real(wp) :: numbers(self%n_numbers())
    associate (n => size(self%z) - size(self%z_rate))
      numbers = [self%furthest, self%q, self%v, self%q_rest, self%v_rest, real(self%z(:n)), &
                 aimag(self%z(:n)), real(self%z_rest(:n)), aimag(self%z_rest(:n)), self%w, &
                 self%w_rate, self%roughness, self%largest]
    end associate
  end function save_numbers

  pure subroutine load_numbers(self, numbers)
    class(state_type), intent(inout) :: self
    real(wp), intent(in) :: numbers(:)
    integer :: n, p, r
    n = size(self%q)
    p = size(self%z) - size(self%z_rate)
    r = size(self%w)
    self%furthest = numbers(1)
    associate (modes => reshape(numbers(2:1 + 4*n), [n, 4]), &
               poles => reshape(numbers(2 + 4*n:1 + 4*(n + p)), [p, 4]), &
               seen => reshape(numbers(2 + 4*(n + p):1 + 4*(n + p + r)), [r, 4]))
      self%q = modes(:, 1)
      self%v = modes(:, 2)
      self%q_rest = modes(:, 3)
      self%v_rest = modes(:, 4)
      self%z(:p) = cmplx(poles(:, 1), poles(:, 2), wp)
      self%z_rest(:p) = cmplx(poles(:, 3), poles(:, 4), wp)
      self%w = seen(:, 1)
      self%w_rate = seen(:, 2)
      self%roughness = seen(:, 3)
      self%largest = seen(:, 4)
    end associate
  end subroutine load_numbers

  !> The massless variables: values, rounding errors, and rates.
  pure function at_once_numbers(self) result(numbers)
    class(state_type), intent(in) :: self
    real(wp) :: numbers(3*size(self%z_rate))
    associate (p => size(self%z) - size(self%z_rate))
      numbers = [real(self%z(p + 1:)), real(self%z_rest(p + 1:)), self%z_rate]
    end associate
  end function at_once_numbers

  pure subroutine load_at_once(self, numbers)
    class(state_type), intent(inout) :: self
    real(wp), intent(in) :: numbers(:)
    integer :: n, p
    n = size(self%z_rate)
    p = size(self%z) - n
    self%z(p + 1:) = cmplx(numbers(:n), 0.0_wp, wp)
    self%z_rest(p + 1:) = cmplx(numbers(n + 1:2*n), 0.0_wp, wp)
    self%z_rate = numbers(2*n + 1:)
  end subroutine load_at_once

  !> Pad sections to whole blocks; additional sections do not move.
  pure type(sections_type) function padded_sections(sections) result(padded)
    type(sections_type), intent(in) :: sections
    integer :: n
    n = size(sections%squares)
    allocate (padded%squares(whole(n)), padded%rates(whole(n)), source=0.0_wp)
    padded%squares(:n) = sections%squares
    padded%rates(:n) = sections%rates
    padded%seen = padded_rows(sections%seen)
    padded%pushed = padded_rows(sections%pushed)
    padded%frequencies = sections%frequencies
    allocate (padded%waves(whole(n), size(sections%waves, 2)), source=(0.0_wp, 0.0_wp))
    padded%waves(:n, :) = sections%waves
    padded%others = sections%others
    padded%inner = sections%inner
  end function padded_sections

  pure function padded_rows(rows) result(padded)
    real(wp), intent(in) :: rows(:, :)
    real(wp) :: padded(whole(size(rows, 1)), size(rows, 2))
    padded = 0.0_wp
    padded(:size(rows, 1), :) = rows
  end function padded_rows

  pure integer function whole(n)
    integer, intent(in) :: n
    whole = (n + mode_block - 1)/mode_block*mode_block
  end function whole

end module viscovib_structure_state
