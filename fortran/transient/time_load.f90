! Optimize: -O2
!> Loads in time: sinusoids of any frequencies, and a piecewise polynomial.
module viscovib_time_load
  use viscovib_constants, only: imaginary_unit
  use viscovib_counters, only: count_up, counted_loads, counting
  use viscovib_kinds, only: wp
  use viscovib_phases, only: split_phase, step_phase
  implicit none
  private

  public :: time_load_type, load_clock, new_clock, new_swing

  type :: time_load_type
    !> Im sum_k amplitude(:,k) exp(i frequency(k) t) on the coordinates, shapes (m)
    !! and (n_dof, m); a constant is a frequency of 0.
    real(wp), allocatable :: frequencies(:)
    complex(wp), allocatable :: amplitudes(:, :)
    !> Polynomials between breaks, sum_p pieces(:,p,i) (t - breaks(i))^(n_powers-p), shape
    !! (n_dof, n_powers, n_breaks); nothing before the first break and after the last.
    real(wp), allocatable :: breaks(:), pieces(:, :, :)
  contains
    procedure :: at
    procedure :: at_times
    procedure, private :: add_table
  end type time_load_type

  !> Evaluates a load along equal steps, with phases accurate to the last digit.
  type :: load_clock
    !> The start of the present step.
    real(wp) :: t = 0.0_wp
    real(wp), allocatable :: high(:), low(:)
    real(wp), allocatable, private :: step_high(:), step_low(:), c(:)
    !> Amplitudes rotated to the nodes, factors of the sine and of the cosine of the
    !! phase at the start of the step, one column per frequency.
    real(wp), allocatable, private :: turned_sine(:, :), turned_cosine(:, :)
    integer, private :: piece = 1
  contains
    procedure :: at_nodes
    procedure :: advance
  end type load_clock

contains

  !> Load at one time, shape (n_dof); `piece` as of `add_table`.
  pure subroutine at(self, t, f, piece)
    class(time_load_type), intent(in) :: self
    real(wp), intent(in) :: t
    real(wp), intent(out) :: f(:)
    integer, intent(inout), optional :: piece
    integer :: k, guess

    f = 0.0_wp
    do k = 1, size(self%frequencies)
      f = f + aimag(self%amplitudes(:, k)*exp(imaginary_unit*(self%frequencies(k)*t)))
    end do
    guess = 1
    if (present(piece)) guess = piece
    call self%add_table(t, guess, f)
    if (present(piece)) piece = guess
  end subroutine at

  !> Load at ascending times, shape (size(t), n_dof).
  pure function at_times(self, t) result(loads)
    class(time_load_type), intent(in) :: self
    real(wp), intent(in) :: t(:)
    real(wp) :: loads(size(t), size(self%amplitudes, 1))
    integer :: i, piece
    piece = 1
    do i = 1, size(t)
      call self%at(t(i), loads(i, :), piece)
    end do
  end function at_times

  !> Add the polynomial at t; `piece` is the first guess of its interval and returns the interval.
  pure subroutine add_table(self, t, piece, f)
    class(time_load_type), intent(in) :: self
    real(wp), intent(in) :: t
    integer, intent(inout) :: piece
    real(wp), intent(inout) :: f(:)
    real(wp) :: value(size(f)), x
    integer :: k, n

    n = size(self%breaks)
    if (n < 2) return
    if (t < self%breaks(1) .or. t > self%breaks(n)) return
    do while (piece > 1 .and. t < self%breaks(piece))
      piece = piece - 1
    end do
    do while (piece < n - 1 .and. t >= self%breaks(piece + 1))
      piece = piece + 1
    end do
    x = t - self%breaks(piece)
    value = self%pieces(:, 1, piece)
    do k = 2, size(self%pieces, 2)
      value = value*x + self%pieces(:, k, piece)
    end do
    f = f + value
  end subroutine add_table

  !> A clock at time start, for steps h with nodes c in [0, 1].
  subroutine new_clock(clock, load, start, h, c)
    type(load_clock), intent(out) :: clock
    type(time_load_type), intent(in) :: load
    real(wp), intent(in) :: start, h, c(:)
    complex(wp) :: turned(size(c)*size(load%amplitudes, 1), size(load%frequencies))
    integer :: i, k

    do k = 1, size(load%frequencies)
      do i = 1, size(c)
        turned(i::size(c), k) = load%amplitudes(:, k) &
                                *exp(imaginary_unit*(load%frequencies(k)*h*c(i)))
      end do
    end do
    call new_swing(clock, load%frequencies, turned, start, h)
    clock%c = h*c
  end subroutine new_clock

  !> A clock of any quantities that are harmonic with the load: their amplitudes at phase 0 at the
  !! start of a step, shape (n, m), in place of the load amplitudes at the nodes.
  subroutine new_swing(clock, frequencies, amplitudes, start, h)
    type(load_clock), intent(out) :: clock
    real(wp), intent(in) :: frequencies(:), start, h
    complex(wp), intent(in) :: amplitudes(:, :)
    integer :: m

    m = size(frequencies)
    clock%t = start
    allocate (clock%c(0), clock%high(m), clock%low(m), clock%step_high(m), clock%step_low(m))
    call split_phase(frequencies, start, clock%high, clock%low)
    call split_phase(frequencies, h, clock%step_high, clock%step_low)
    clock%turned_sine = real(amplitudes)
    clock%turned_cosine = aimag(amplitudes)
  end subroutine new_swing

  !> Load at the nodes of the present step, node i of coordinate d at (d-1) s + i.
  subroutine at_nodes(self, load, f)
    class(load_clock), intent(inout) :: self
    type(time_load_type), intent(in) :: load
    real(wp), intent(out), contiguous :: f(:)
    integer :: k

    if (counting) call count_up(counted_loads, size(self%high))
    f = 0.0_wp
    do k = 1, size(self%high)
      call add_wave(size(f), self%turned_sine(:, k), self%turned_cosine(:, k), self%high(k), &
                    self%low(k), f)
    end do
    if (size(load%breaks) > 1) call add_table_at_nodes(self, load, f)
  end subroutine at_nodes

  pure subroutine add_wave(n, of_sine, of_cosine, high, low, f)
    integer, intent(in) :: n
    real(wp), intent(in) :: of_sine(n), of_cosine(n), high, low
    real(wp), intent(inout) :: f(n)
    real(wp) :: s, c
    s = sin(high)
    c = cos(high)
    f = f + (of_sine*(s + c*low) + of_cosine*(c - s*low))
  end subroutine add_wave

  subroutine add_table_at_nodes(self, load, f)
    class(load_clock), intent(inout) :: self
    type(time_load_type), intent(in) :: load
    real(wp), intent(inout) :: f(:)
    real(wp) :: part(size(load%pieces, 1))
    integer :: i, s
    s = size(self%c)
    do i = 1, s
      part = f(i::s)
      call load%add_table(self%t + self%c(i), self%piece, part)
      f(i::s) = part
    end do
  end subroutine add_table_at_nodes

  !> Advance to the start of the next step, at time t.
  subroutine advance(self, t)
    class(load_clock), intent(inout) :: self
    real(wp), intent(in) :: t
    self%t = t
    call step_phase(self%high, self%low, self%step_high, self%step_low)
  end subroutine advance

end module viscovib_time_load
