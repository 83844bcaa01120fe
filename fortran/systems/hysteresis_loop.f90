!> Periodic cycles of hysteresis elements.
!!
!! A cycle is given by its deflections d_1, ..., d_n. Between them, and from d_n back to d_1, the
!! deflection does not reverse. The periodic states solve z = t Phi(z), where Phi is the map over
!! one cycle and t = -1 for half a period. States that lose their initial value are found by
!! Newton's method with dPhi/dz. States that stick all the time keep their value; they start from 0
!! and run until they repeat.
module viscovib_hysteresis_loop
  use viscovib_hysteresis, only: hysteresis_type
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: find_start, run_loop

  !> Maximum number of cycles; dPhi/dz closer to 1 than `as_one` counts as 1.
  integer, parameter :: max_cycles = 100
  real(wp), parameter :: as_one = 1.0e-6_wp

contains

  !> Periodic states at the first deflection, and their derivatives by all deflections.
  pure subroutine find_start(element, d, turn, z, by_d, multiplier)
    class(hysteresis_type), intent(in) :: element
    !> Shape (n).
    real(wp), intent(in) :: d(:)
    !> 1: the cycle ends at d(1); -1: at -d(1), half a period later.
    integer, intent(in) :: turn
    !> Shape (n_states).
    real(wp), intent(out) :: z(:)
    !> Shape (n_states, n).
    real(wp), intent(out) :: by_d(:, :)
    !> t dPhi/dz, shape (n_states): the fraction of a state that remains after a cycle.
    real(wp), intent(out) :: multiplier(:)
    real(wp), dimension(size(z)) :: before, by_z, by_change
    real(wp) :: once(size(z), size(d)), size_of, work
    integer :: cycle_number, i, j, next

    z = 0.0_wp
    once = 0.0_wp
    call element%advance(d(1), z, by_z, by_change, work)
    once(:, 1) = by_change
    do cycle_number = 1, max_cycles
      before = z
      by_d = once
      once = 0.0_wp
      multiplier = 1.0_wp
      size_of = maxval(abs(z))
      do i = 1, size(d)
        next = merge(1, i + 1, i == size(d))
        associate (ahead => merge(turn, 1, i == size(d)))
          call element%advance(ahead*d(next) - d(i), z, by_z, by_change, work)
          do j = 1, size(d)
            once(:, j) = by_z*once(:, j)
          end do
          once(:, next) = once(:, next) + ahead*by_change
          once(:, i) = once(:, i) - by_change
          multiplier = multiplier*by_z
        end associate
        size_of = max(size_of, maxval(abs(z)))
      end do
      z = turn*z
      once = turn*once
      multiplier = turn*multiplier
      do j = 1, size(d)
        ! The dependence on the initial states is solved for separately.
        where (abs(1.0_wp - multiplier) > as_one)
          by_z = 1.0_wp/(1.0_wp - multiplier)
          by_change = by_z*once(:, j)
        else where
          by_change = by_d(:, j) + once(:, j)
        end where
        once(:, j) = by_change
      end do
      if (maxval(abs(z - before)) <= 4.0_wp*epsilon(1.0_wp)*size_of) exit
      where (abs(1.0_wp - multiplier) > as_one) z = before + (z - before)/(1.0_wp - multiplier)
    end do
    by_d = once
  end subroutine find_start

  !> Force over a periodic cycle of samples, linear between them, and the energy lost per cycle.
  pure subroutine run_loop(element, d, force, lost)
    class(hysteresis_type), intent(in) :: element
    !> Shapes (n); the cycle begins with d(1) again.
    real(wp), intent(in) :: d(:)
    real(wp), intent(out) :: force(:), lost
    real(wp), dimension(element%n_states()) :: z, by_z, by_change, multiplier
    real(wp) :: turns(size(d)), by_turns(element%n_states(), size(d)), work
    integer :: i, n

    n = size(d)
    call keep_turns(d, turns, i)
    call find_start(element, turns(:i), 1, z, by_turns(:, :i), multiplier)
    lost = 0.0_wp
    force(1) = element%force(d(1), z)
    do i = 2, n
      call element%advance(d(i) - d(i - 1), z, by_z, by_change, work)
      force(i) = element%force(d(i), z)
      lost = lost + work
    end do
    call element%advance(d(1) - d(n), z, by_z, by_change, work)
    lost = lost + work
  end subroutine run_loop

  !> The first sample, and the samples where the deflection reverses.
  pure subroutine keep_turns(d, turns, n)
    real(wp), intent(in) :: d(:)
    real(wp), intent(out) :: turns(:)
    integer, intent(out) :: n
    integer :: i

    n = 1
    turns(1) = d(1)
    do i = 2, size(d)
      associate (next => d(merge(1, i + 1, i == size(d))))
        if ((d(i) - turns(n))*(next - d(i)) > 0.0_wp) cycle
        if (.not. abs(d(i) - turns(n)) > 0.0_wp) cycle
        n = n + 1
        turns(n) = d(i)
      end associate
    end do
  end subroutine keep_turns

end module viscovib_hysteresis_loop
