!> Where a motion stops because a force law has no value beyond.
module viscovib_law_end
  use viscovib_kinds, only: wp
  use viscovib_law_term, only: law_term
  use viscovib_law_program, only: wall
  use viscovib_status, only: show
  implicit none
  private

  public :: told_law_end

  !> Places of the way that are looked at.
  integer, parameter :: n_places = 41

contains

  !> "; a force law has no value beyond x = -1", or nothing where all laws have values.
  function told_law_end(laws, names, state, reach) result(text)
    type(law_term), intent(in) :: laws(:)
    !> Of the coordinates.
    character(len=*), intent(in) :: names(:)
    !> At the stop, (q_1, v_1, q_2, ...); how far the motion may go on (s).
    real(wp), intent(in) :: state(:), reach
    character(len=:), allocatable :: text
    real(wp) :: q(n_places, size(names)), value(n_places)
    integer :: b, i, k

    text = ''
    do k = 1, n_places
      ! From the state itself on, in equal parts.
      q(k, :) = state(1::2) + reach*real(k - 1, wp)/real(n_places - 1, wp)*state(2::2)
    end do
    do i = 1, size(laws)
      if (laws(i)%state > 0) cycle
      call laws(i)%program%evaluate(matmul(q, transpose(laws(i)%arguments)) &
                                    + spread(matmul(laws(i)%rates, state(2::2)), 1, n_places), &
                                    value)
      ! What has no value is a wall, exactly.
      if (.not. any(abs(value - wall) <= 0.0_wp)) cycle
      k = findloc(abs(value - wall) <= 0.0_wp, .true., 1)
      do b = 1, size(names)
        if (.not. any(abs(laws(i)%arguments(:, b)) > 0.0_wp)) cycle
        if (len(text) > 0) text = text//','
        text = text//' '//trim(names(b))//' = '//show(six_digits(q(k, b)))
      end do
      text = '; a force law has no value beyond'//text
      return
    end do
  end function told_law_end

  !> As near as the place is known.
  pure real(wp) function six_digits(x)
    real(wp), intent(in) :: x
    real(wp) :: unit
    six_digits = 0.0_wp
    if (.not. abs(x) > tiny(1.0_wp)) return
    unit = 10.0_wp**(5 - floor(log10(abs(x))))
    six_digits = anint(x*unit)/unit
  end function six_digits

end module viscovib_law_end
