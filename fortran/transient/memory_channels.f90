! Optimize: -O1
!> The memory channels of a system: the hereditary variables, or if forces are linear
!! in them and share a kernel, the fewer forces that they sum to.
!!
!! F(u, v) = B w + r(u, v) - S (R*g) with channels g = T w(u), each with one kernel.
module viscovib_memory_channels
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: channels_type, is_steep, new_channels, variables_of

  type :: channels_type
    !> T, shape (n_channels, n_memory), and S, shape (n_dof, n_channels).
    real(wp), allocatable :: gather(:, :), spread(:, :)
    !> Kernel of each channel, ascending.
    integer, allocatable :: kernel_of(:)
    !> Channels of the displacement held for all t < 0, and R* of them if it were
    !! held for all later times, shape (n_channels); 0 after rest.
    real(wp), allocatable :: held(:), held_recalled(:)
  end type channels_type

contains

  subroutine new_channels(channels, system, held)
    type(channels_type), intent(out) :: channels
    class(oscillator_type), intent(in) :: system
    !> Displacement for all t < 0, shape (n_dof); must be 0 unless the kernels have
    !! integrals.
    real(wp), intent(in) :: held(:)
    real(wp), allocatable :: gather(:, :), spread(:, :)
    integer, allocatable :: members(:), kernel_of(:)
    integer :: i, j, k, n

    allocate (kernel_of(0))
    allocate (gather(system%n_memory(), system%n_memory()))
    allocate (spread(system%n_dof(), system%n_memory()))
    gather = 0.0_wp
    spread = 0.0_wp
    n = 0
    do k = 1, size(system%kernels)
      members = pack([(j, j=1, system%n_memory())], system%kernel_of == k)
      if (system%separable .and. size(members) > system%n_dof()) then
        do i = 1, system%n_dof()
          n = n + 1
          gather(n, members) = system%spread(i, members)
          spread(i, n) = 1.0_wp
          kernel_of = [kernel_of, k]
        end do
      else
        do i = 1, size(members)
          n = n + 1
          gather(n, members(i)) = 1.0_wp
          spread(:, n) = system%spread(:, members(i))
          kernel_of = [kernel_of, k]
        end do
      end if
    end do
    channels%gather = gather(:n, :)
    channels%spread = spread(:, :n)
    channels%kernel_of = kernel_of
    call set_held(channels, system, held)
  end subroutine new_channels

  subroutine set_held(channels, system, held)
    type(channels_type), intent(inout) :: channels
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: held(:)
    integer :: c

    channels%held = 0.0_wp*channels%kernel_of
    channels%held_recalled = channels%held
    if (.not. any(abs(held) > 0.0_wp)) return
    channels%held = matmul(channels%gather, variables_of(system, held))
    do c = 1, size(channels%kernel_of)
      channels%held_recalled(c) = system%kernels(channels%kernel_of(c))%integral()*channels%held(c)
    end do
  end subroutine set_held

  !> The hereditary variables of a constant displacement.
  function variables_of(system, held)
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: held(:)
    real(wp) :: variables_of(system%n_memory())
    real(wp) :: u(1, size(held) + system%n_rates()), w(1, system%n_memory())
    integer :: c

    u = 0.0_wp
    u(1, :size(held)) = held
    w = 0.0_wp
    if (any(system%bent)) call system%deflection_remainder(u, w)
    do c = 1, system%n_memory()
      if (.not. system%bent(c)) w(1, c) = 0.0_wp
    end do
    variables_of = w(1, :) + matmul(system%gather, held)
  end function variables_of

  !> True if a kernel grows without bound towards 0, or decays well within a step h.
  logical function is_steep(system, channels, h)
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    real(wp), intent(in) :: h
    real(wp) :: values(2)
    integer :: k

    is_steep = .false.
    do k = 1, size(system%kernels)
      if (.not. any(channels%kernel_of == k)) cycle
      call system%kernels(k)%value([1.0e-9_wp*h, 1.0e-2_wp*h], values)
      is_steep = is_steep .or. abs(values(1) - values(2)) > 0.1_wp*abs(values(2))
    end do
  end function is_steep

end module viscovib_memory_channels
