!> Initial state of the hidden masses that represent memory, for a motion with a known past.
!!
!! Let g_h be the variable held for all t < 0, or before the first of known times. The difference
!! g - g_h has a beginning:
!!
!!   R*g = I g_h + R*(g - g_h),   I = integral_0^inf R dt,
!!
!! so that a sum of exponentials must represent R only for the time of a run: the force I g_h is
!! a constant load, each mass (viscovib_hidden_memory) is dragged by g - g_h, and begins with
!!
!!   m z' = integral_(-inf)^0 exp(r s) (g - g_h) ds.
module viscovib_hidden_start
  use viscovib_gauss_points, only: points_32, weights_32
  use viscovib_hidden_memory, only: list_hidden
  use viscovib_kernel, only: vanished
  use viscovib_kinds, only: wp
  use viscovib_known_past, only: known_past_type, new_known_past
  use viscovib_memory_channels, only: channels_type, variables_of
  use viscovib_polynomial, only: polynomial_type
  use viscovib_polynomial_motion, only: polynomial_motion_type
  use viscovib_status, only: fail, set_ok, status_input_error, status_type
  implicit none
  private

  public :: begin_hidden

contains

  !> Initialize a motion with its past.
  subroutine begin_hidden(motion, system, fitted, held, status, before, moved)
    type(polynomial_motion_type), intent(inout) :: motion
    !> With its own kernels, and with the kernels of the motion.
    type(polynomial_type), intent(in) :: system, fitted
    !> Displacement held for all t < 0, shape (n_dof).
    real(wp), intent(in) :: held(:)
    type(status_type), intent(out) :: status
    !> Times ascending to 0 and displacements there, shapes (n) and (n_dof, n), if the motion
    !! before 0 is known; `held` is then the first of these displacements.
    real(wp), intent(in), optional :: before(:), moved(:, :)
    type(channels_type) :: channels
    type(known_past_type) :: past
    integer, allocatable :: variables(:)
    real(wp), allocatable :: rates(:), masses(:)
    real(wp) :: force(motion%n_dof)
    integer :: i, j, n

    call set_ok(status)
    if (motion%n_hidden == 0) return
    n = system%n_dof()
    if (any(abs(held) > 0.0_wp) .and. system%kernel_without_integral() > 0) then
      call fail(status, status_input_error, 'held', 'held: must be 0, because a kernel has no ' &
                //'finite integral: a deflection held for all t < 0 has no force')
      return
    end if
    call list_hidden(fitted, variables, rates, masses)
    channels%kernel_of = system%kernel_of
    channels%gather = spread(0.0_wp*system%kernel_of, 2, size(system%kernel_of))
    do j = 1, size(system%kernel_of)
      channels%gather(j, j) = 1.0_wp
    end do
    channels%held = 0.0_wp*system%kernel_of
    if (any(abs(held) > 0.0_wp)) then
      channels%held = variables_of(system, held)
      force = 0.0_wp
      do j = 1, size(system%kernel_of)
        if (system%kernel_of(j) == 0) cycle
        force(:n) = force(:n) + system%spread(:, j) &
                    *(system%kernels(system%kernel_of(j))%integral()*channels%held(j))
      end do
      force(n + 1:) = -channels%held(variables)
      call motion%hold(force)
    end if
    if (.not. present(before)) return
    if (size(before) < 2) return
    call new_known_past(past, system, channels, before, moved)
    motion%hidden_speeds = [(dragged(past, variables(i), rates(i))/masses(i), i=1, size(rates))]
  end subroutine begin_hidden

  !> integral exp(r s) (g - g_h) ds over the times of a past.
  real(wp) function dragged(past, variable, rate)
    type(known_past_type), intent(in) :: past
    integer, intent(in) :: variable
    real(wp), intent(in) :: rate
    real(wp) :: length, part, s
    integer :: i, k

    dragged = 0.0_wp
    do i = size(past%g, 3), 1, -1
      if (-rate*past%times(i) > vanished) exit
      length = past%times(i) - past%times(i - 1)
      part = length
      if (rate*length > vanished) part = vanished/rate
      do k = 1, size(points_32)
        s = past%times(i) - part*points_32(k)
        dragged = dragged + part*weights_32(k)*exp(rate*s) &
                  *dot_product(past%table%basis((s - past%times(i - 1))/length), &
                               past%g(:, variable, i))
      end do
    end do
  end function dragged

end module viscovib_hidden_start
