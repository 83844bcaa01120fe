!> The position at which a motion stops because a force law has no value beyond it.
module viscovib_law_end
  use viscovib_kinds, only: wp
  use viscovib_law_term, only: law_term
  use viscovib_law_program, only: wall
  use viscovib_rounded, only: six_digits
  use viscovib_status, only: show
  implicit none
  private

  public :: law_end_text

  !> Number of sample points on the way, and of bisections.
  integer, parameter :: n_places = 41, halvings = 40

contains

  !> "; the law 'log(1 + x)' has no value beyond x = -1", or empty if all laws have values.
  function law_end_text(laws, names, state, reach) result(text)
    type(law_term), intent(in) :: laws(:)
    !> Names of the coordinates.
    character(len=*), intent(in) :: names(:)
    !> At the stop, (q_1, v_1, q_2, ...); largest further time of the motion (s).
    real(wp), intent(in) :: state(:), reach
    character(len=:), allocatable :: text
    real(wp) :: part(n_places), middle
    logical :: outside(n_places)
    integer :: b, i, j, k

    text = ''
    do i = 1, size(laws)
      if (laws(i)%state > 0) cycle
      ! From the state itself in equal parts, then bisection of one of them.
      part = [(reach*real(k - 1, wp)/real(n_places - 1, wp), k=1, n_places)]
      outside = beyond(laws(i), state, part)
      if (.not. any(outside)) cycle
      k = findloc(outside, .true., 1)
      if (k > 1) then
        do j = 1, halvings
          middle = 0.5_wp*(part(k - 1) + part(k))
          outside = beyond(laws(i), state, spread(middle, 1, n_places))
          part(merge(k, k - 1, outside(1))) = middle
        end do
      end if
      do b = 1, size(names)
        if (.not. any(abs(laws(i)%arguments(:, b)) > 0.0_wp)) cycle
        if (len(text) > 0) text = text//','
        text = text//' '//trim(names(b))//' = ' &
               //show(six_digits(state(2*b - 1) + part(k)*state(2*b)))
      end do
      if (allocated(laws(i)%text)) then
        text = "; the law '"//laws(i)%text//"' has no value beyond"//text
      else
        text = '; a force law has no value beyond'//text
      end if
      return
    end do
  end function law_end_text

  !> True at times on the way at which a law has no value.
  pure function beyond(law, state, part)
    type(law_term), intent(in) :: law
    real(wp), intent(in) :: state(:), part(:)
    logical :: beyond(size(part))
    real(wp) :: q(size(part), size(state)/2), value(size(part))
    integer :: k
    do k = 1, size(part)
      q(k, :) = state(1::2) + part(k)*state(2::2)
    end do
    call law%program%evaluate(matmul(q, transpose(law%arguments)) &
                              + spread(matmul(law%rates, state(2::2)), 1, size(part)), value)
    ! A missing value is represented by exactly `wall`.
    beyond = abs(value - wall) <= 0.0_wp
  end function beyond

end module viscovib_law_end
